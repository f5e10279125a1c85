"""The founding paper, reproduced: `localiser paper` in a clone of the project."""
