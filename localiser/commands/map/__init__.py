"""`localiser map`: build maps, look at them, check and mend them."""
