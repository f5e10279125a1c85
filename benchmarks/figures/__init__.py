"""What the baseline measures: a group of figures a file."""
