"""What a user can choose about a fit beside the orders of its pair."""

from dataclasses import dataclass
from typing import Literal

from .channels import REGRESSORS
from .noise_choice import NoiseChoice
from .robust import Loss

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
