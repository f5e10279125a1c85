"""`localiser paper`: the founding paper, reproduced."""
