"""Replay a log: events in, results out."""
