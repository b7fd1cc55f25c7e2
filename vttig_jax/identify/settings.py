"""The settings of a fit: everything a user can choose beside the harmonic orders of the pair."""

from dataclasses import dataclass
from typing import Literal

Loss = Literal["square", "huber", "bisquare"]


REGRESSORS = ("torque", "acceleration", "speed")
"""What a user can ask for by name; the delay, the drift and the ratio have options of their own."""


HIGHEST_LAG = 16
"""Highest autoregressive order."""


@dataclass(frozen=True)
class NoiseChoice:
    """Kind of the noise, and what it has in common.

    **Arguments**
    - `kind`: "ar", an autoregression whose order follows the logs; "white" for none; "ou", an
      Ornstein–Uhlenbeck process, for rows at unequal times.
    - `stationary_in`: "time" makes rows of equal duration, "angle" rows of equal driving angle.
    - `of`: "rig" for one noise everywhere, "plateau" for one of its own at every speed.

    **Raises** `ValueError` naming the argument.
    """

    kind: Literal["ar", "white", "ou"] = "ar"
    stationary_in: Literal["time", "angle"] = "time"
    of: Literal["rig", "plateau"] = "rig"

    def __post_init__(self):
        known = {
            "kind": ("ar", "white", "ou"),
            "stationary_in": ("time", "angle"),
            "of": ("rig", "plateau"),
        }
        for name, words in known.items():
            if getattr(self, name) not in words:
                listed = " or ".join(f'"{word}"' for word in words)
                raise ValueError(
                    f"Argument `{name}` must be {listed}, but is {getattr(self, name)!r}."
                )


HIGHEST_DRIFT = 6
LONGEST_DELAY_S = 1.0


@dataclass(frozen=True)
class Choices:
    """Options of `fit`; see there.

    **Raises** `ValueError` naming the argument.
    """

    encoder_terms: bool = True
    drift_order: int | None = None
    drift_knots_s: float | None = None
    delay: float | Literal["auto", "free", "off"] = "auto"
    loss: Loss | Literal["auto"] = "auto"
    regressors: tuple[str, ...] = ()
    free_ratio: bool = False
    same_zero: bool | None = None
    use_readings: bool = False
    gear_terms: bool = True
    noise: NoiseChoice = NoiseChoice()

    def __post_init__(self):
        if not (self.encoder_terms or self.gear_terms):
            raise ValueError(
                "Argument `gear_terms` must be True where `encoder_terms` is False, but both are"
                " False: nothing would be left to fit."
            )
        order = self.drift_order
        if order is not None and not 0 <= order <= HIGHEST_DRIFT:
            raise ValueError(
                f"Argument `drift_order` must be 0 … {HIGHEST_DRIFT}, but is {order!r}."
            )
        if self.drift_knots_s is not None and not self.drift_knots_s > 0:
            raise ValueError(
                f"Argument `drift_knots_s` must be positive, but is {self.drift_knots_s!r}."
            )
        if order is not None and self.drift_knots_s is not None:
            raise ValueError(
                "Argument `drift_order` must be left out where `drift_knots_s` is given, but both"
                " are there."
            )
        if not isinstance(self.delay, str):
            if not abs(self.delay) <= LONGEST_DELAY_S:
                raise ValueError(
                    f"Argument `delay` must lie within ±{LONGEST_DELAY_S:g} s, but is"
                    f" {self.delay!r}."
                )
        elif self.delay not in ("auto", "free", "off"):
            raise ValueError(
                f'Argument `delay` must be "auto", "free", "off" or seconds, but is {self.delay!r}.'
            )
        if self.loss not in ("auto", "square", "huber", "bisquare"):
            raise ValueError(
                'Argument `loss` must be "auto", "square", "huber" or "bisquare", but is'
                f" {self.loss!r}."
            )
        for name in self.regressors:
            if name not in REGRESSORS:
                raise ValueError(
                    f"Argument `regressors` must hold names of {', '.join(REGRESSORS)}, but holds"
                    f" {name!r}."
                )
