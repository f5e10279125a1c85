"""The loops of the program: replay a log, simulate one, judge runs."""
