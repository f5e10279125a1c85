"""What the scoreboard is made of: drives, what goes wrong with them, figures of a run, rows, and the page."""
