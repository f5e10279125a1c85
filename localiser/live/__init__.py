"""A running robot: messages in, poses out; the same filter as in a replay."""
