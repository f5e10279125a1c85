"""Rows of batches, as tables have them."""

from typing import Any


def row(log: str, seed: int, rmse_m: float | None, **others: Any) -> dict[str, Any]:
    """Return the row of a run; without an error it failed."""
    return {
        "log": log, "log_path": f"logs/{log}", "log_id": f"id of {log}", "config": None, "seed": seed,
        "error": "no such log" if rmse_m is None else None, "position_rmse_m": rmse_m,
    } | others  # fmt: skip
