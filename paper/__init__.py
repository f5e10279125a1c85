"""The founding paper, reproduced: `python -m paper` in a clone of the project."""
