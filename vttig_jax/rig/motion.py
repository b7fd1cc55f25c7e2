"""Prescribed motion of the driving shaft: passes between two angles, with ramps and dwells."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..base.units import DEG, REV


@dataclass(frozen=True)
class PassMotion:
    """Motion of trapezoidal speed from 0 to `reversal_deg` and back, with a dwell after each pass.

    A pass is one motion in one direction; forward and backward passes alternate.

    **Arguments**
    - `speed_rpm`: steady speed of the driving shaft.
    - `reversal_deg`: driving angle of the reversal.
    - `dwell_s`: standstill after every pass.
    - `ramp_s`: time from standstill to the steady speed, at constant acceleration.
    - `passes`: number of passes, one more than reversals; 1 for a forward pass only.
    - `ripple`, `ripple_order`: amplitude of the speed ripple as a fraction of the speed, and its
      cycles per driving revolution.

    **Raises** `ValueError` if `reversal_deg` is too small for both ramps, if `speed_rpm`,
    `reversal_deg`, `passes` or `ripple_order` is not positive, and if `dwell_s`, `ramp_s` or
    `ripple` is negative; these three may be 0.
    """

    speed_rpm: float = 60.0
    reversal_deg: float = 7560.0
    dwell_s: float = 2.0
    ramp_s: float = 0.5
    passes: int = 2
    ripple: float = 0.001
    ripple_order: int = 6

    def __post_init__(self):
        for name in ("speed_rpm", "reversal_deg", "passes", "ripple_order"):
            if not getattr(self, name) > 0:
                raise ValueError(
                    f"Argument `{name}` must be positive, but is {getattr(self, name)!r}."
                )
        for name in ("dwell_s", "ramp_s", "ripple"):
            if not getattr(self, name) >= 0:
                raise ValueError(
                    f"Argument `{name}` must not be negative, but is {getattr(self, name)!r}."
                )
        if self._steady_s < 0:
            raise ValueError(
                f"Argument `reversal_deg` must be at least {self._speed * self.ramp_s / DEG:g}°"
                f" (both ramps), but is {self.reversal_deg:g}°."
            )

    @property
    def _speed(self) -> float:
        return self.speed_rpm * REV / 60.0

    @property
    def _steady_s(self) -> float:
        """Time at steady speed; both ramps cover the angle of `ramp_s` at steady speed."""
        return self.reversal_deg * DEG / self._speed - self.ramp_s

    @property
    def duration_s(self) -> float:
        """Duration of the run, including the dwell after the last pass."""
        return self.passes * (self._steady_s + 2 * self.ramp_s + self.dwell_s)

    def driving_angle(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the driving angle (rad) at times in s; at rest before 0 and after the run."""
        period = self.duration_s / self.passes
        inside = np.clip(time, 0.0, self.duration_s)
        index = np.minimum(inside // period, self.passes - 1)
        travelled = self._travelled(inside - index * period)
        angle = np.where(index % 2 == 0, travelled, self.reversal_deg * DEG - travelled)
        return angle + self.ripple / self.ripple_order * np.sin(self.ripple_order * angle)

    def _travelled(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the angle (rad) since the start of a pass: the integral of the trapezoid."""
        ramp = self.ramp_s
        end = self._steady_s + 2 * ramp
        up, down = np.clip(time, 0, ramp), np.clip(end - time, 0, ramp)
        steady = np.clip(time - ramp, 0, self._steady_s)
        if ramp == 0:
            return self._speed * steady
        slowing = np.where(time > end - ramp, ramp**2 - down**2, 0.0)
        return self._speed * (up**2 / (2 * ramp) + steady + slowing / (2 * ramp))
