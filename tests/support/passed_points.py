"""Points at unknown distances that a camera passes, and the best density of their bearings afterwards."""

from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array, wrap_angle

SIGMA, TURN_SIGMA = 0.02, 0.01  # rad, of a bearing and of the turn
COUNT = 20_000


@dataclass(frozen=True)
class PassedPoints:
    """Bearings (COUNT,) measured before and after a step of the camera (right m, backward m, turn rad)."""

    first: Array
    second: Array
    turn: float

    @classmethod
    def by(cls, step: tuple[float, float, float], near_m: float) -> "PassedPoints":
        """Return points at an even 1/r, none nearer than near_m."""
        rng = np.random.default_rng(0)
        bearing = rng.uniform(-0.5, 0.5, COUNT)
        range_m = 1.0 / rng.uniform(1e-3, 1.0 / near_m, COUNT)
        right, back, turn = step
        ahead = range_m * np.cos(bearing) + back
        aside = range_m * np.sin(bearing) - right
        after = np.arctan2(aside, ahead) + turn + TURN_SIGMA * rng.standard_normal(COUNT)
        first, second = (true + SIGMA * rng.standard_normal(COUNT) for true in (bearing, after))
        return cls(first, second, turn)

    def best(self, span: float) -> float:
        """Return the mean logarithm of the best density over 1 / span: a histogram of what really happens."""
        error = wrap_angle(self.second - self.first - self.turn)
        share, border = np.histogram(error, 60, density=True)
        return float(np.log(span * share[np.clip(np.searchsorted(border, error) - 1, 0, 59)]).mean())
