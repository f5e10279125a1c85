"""`localiser convert`: logs to bags and back."""
