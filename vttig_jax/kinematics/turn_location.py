"""Identification of the turn within the hunting period from one single-turn reading of each shaft.

The backlash depends on φ₁ over the whole hunting period, but a single-turn encoder measures φ₁
modulo one turn. The driven shaft gives the turn: at φ₁ = θ₁ + 2πk its angle is i φ₁ + TE, and over
the n turns of the period i·2πk takes n values that are 2π/n apart. The turn is the k for which

    x_k = φ₂ − i (θ₁ + 2πk)    (modulo 2π)

lies in the range of the transmission error of this pair.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr, softmax

from ..base.errors import NoAnswerError
from ..base.files.text_tables import key_values
from ..base.runtime import require_x64
from ..base.units import ARCSEC, DEG, REV
from ..pair.gear_pair import Flank
from .flank_model import FlankModel, flank_index

Reading = float | Float[np.ndarray, "*readings"]

Turns = Float[np.ndarray, "*#readings turns"]
"""Numbers of every turn of the hunting period, for one reading or for several."""

FARTHEST = 6.0
"""Largest misfit, in standard deviations, with which readings still fit a turn (chosen)."""

TITLE = "place in the hunting period"

_NARROW = 1e-4
"""Gap width, in standard deviations, below which the gap is treated as a point (chosen)."""

_MOST_TURNS = 2**20  # a chosen limit: the driven angles of two turns are then 1.2″ apart


@dataclass(frozen=True)
class Located:
    """Most probable turn within the hunting period.

    **Arguments**
    - `turn`: number of the turn, 0 … hunting turns − 1, counted from φ₁ = 0.
    - `probability`: posterior probability of that turn; all turns have the same prior probability.
    - `driving_rad`: φ₁ in [0, 2π hunting turns), rad.
    - `runner_up`, `runner_up_probability`: second most probable turn and its probability; None and
      0 if the hunting period has only one turn.
    - `misfit_rad`: distance of the driven shaft from the gap, or from the known flank, rad.
    - `std_rad`: standard deviation of φ₂ − i φ₁ that was assumed, rad.
    - `probabilities`: posterior probabilities of all turns, shape (hunting turns,).
    - `flank`: flank in contact, or None if it is unknown.
    """

    turn: int
    probability: float
    driving_rad: float
    runner_up: int | None
    runner_up_probability: float
    misfit_rad: float
    std_rad: float
    probabilities: Float[np.ndarray, " turns"]
    flank: Flank | None = None

    @property
    def hunting_turns(self) -> int:
        """Number of turns of the driving shaft in the hunting period."""
        return len(self.probabilities)

    @property
    def fits(self) -> bool:
        """Whether the misfit at the best turn is at most six standard deviations.

        The probabilities only compare the turns with each other. They do not detect readings that
        no turn explains, for example of another pair, with another zero or after a slip.
        """
        return self.misfit_rad <= FARTHEST * self.std_rad

    def rows(self) -> list[tuple[str, str]]:
        """Return (name, text) pairs of the report."""
        rows = [
            ("turn", f"{self.turn} of 0 … {self.hunting_turns - 1}"),
            ("driving angle", f"{self.driving_rad / DEG:.4f}° of {360 * self.hunting_turns}°"),
            ("probability", f"{self.probability:.6g}"),
        ]
        if self.runner_up is not None:
            probability = f"probability {self.runner_up_probability:.2g}"
            rows.append(("runner-up", f"turn {self.runner_up}, {probability}"))
        misfit = f"{self.misfit_rad / ARCSEC:.4g}″"
        if self.flank is not None:
            position = f"{misfit} off flank {self.flank}"
        else:
            position = f"{misfit} outside the gap" if self.misfit_rad else "within the gap"
        rows.append(("driven shaft", f"{position}; readings good to {self.std_rad / ARCSEC:.3g}″"))
        if not self.fits:
            rows.append(("verdict", "these readings fit no turn"))
        return rows

    def __str__(self) -> str:
        return key_values(self.rows(), title=TITLE)


def locate(
    driving_rad: float,
    driven_rad: float,
    ratio: Fraction,
    transmission_error: FlankModel | tuple[float, float],
    *,
    std_rad: float,
    flank: Flank | None = None,
) -> Located:
    """Find the turn within the hunting period from single-turn readings of both shafts.

    If turn k is correct, the driven shaft lies between flanks A and B at the angle of that turn:

        p(x_k | k) = ∫ N(x_k − t; std) dt / (TE_B − TE_A)    over t from TE_A(φ₁) to TE_B(φ₁)

    The likelihood is uniform over the gap, ends included, because a shaft at rest can have any
    position in the gap. A running drive is in contact with a flank; if `flank` is given, the
    likelihood is p = N(x_k − TE_f; std). If the turns differ by more than the gap plus the noise,
    both likelihoods give the same turn.

    **Arguments**
    - `driving_rad`, `driven_rad`: φ₁ and φ₂ modulo one turn, rad, from the zeros of the model.
    - `ratio`: i, driven over driving speed; its denominator is the number of turns.
    - `transmission_error`: measured flank model, which gives TE_A and TE_B at every turn; or two
      constants TE_A and TE_B, rad: (0, backlash) if only the backlash is known.
    - `std_rad`: standard deviation of φ₂ − i φ₁ about the model, rad of the driven shaft. It is
      √(σ₂² + i²σ₁²) for readings with the standard deviations σ₁ and σ₂.
    - `flank`: flank in contact, or None if it is unknown.

    **Raises** `ValueError` for readings that are not finite and for a `std_rad` that is not
    positive and finite, `NoAnswerError` for a period of more than 2²⁰ turns.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from fractions import Fraction
    >>> from vttig_jax.kinematics import locate
    >>> vttig_jax.enable_x64()
    >>> turn, driving = 5, math.radians(123.4)
    >>> driven = 45 / 80 * (2 * math.pi * turn + driving) + math.radians(0.02)
    >>> gap = 0.0, math.radians(0.04)
    >>> result = locate(driving, driven % (2 * math.pi), Fraction(45, 80), gap, std_rad=1e-3)
    >>> result.turn, round(result.probability, 6), round(math.degrees(result.driving_rad), 3)
    (5, 1.0, 1923.4)

    ```
    """
    require_x64("locate")
    turns = ratio.denominator
    _require_possible(driving_rad, driven_rad, std_rad, turns)
    angle = float(np.mod(driving_rad, REV))
    angle = 0.0 if angle == REV else angle
    candidates = angle + REV * np.arange(turns)
    lower, upper = _flanks(transmission_error, candidates)
    if flank is not None:
        lower = upper = (lower, upper)[flank_index(flank)]
    remainder = turn_remainders(angle, driven_rad, lower, upper, float(ratio))
    likelihood = turn_log_likelihood(remainder, lower, upper, std_rad)
    probabilities = softmax(likelihood)
    order = np.argsort(-likelihood, kind="stable")
    best = int(order[0])
    low, high = sorted((float(lower[best]), float(upper[best])))
    error = float(remainder[best])
    return Located(
        turn=best,
        probability=float(probabilities[best]),
        driving_rad=float(candidates[best]),
        runner_up=int(order[1]) if turns > 1 else None,
        runner_up_probability=float(probabilities[order[1]]) if turns > 1 else 0.0,
        misfit_rad=max(0.0, low - error, error - high),
        std_rad=float(std_rad),
        probabilities=probabilities,
        flank=flank,
    )


def turn_remainders(
    driving: Reading, driven: Reading, lower: Turns, upper: Turns, ratio: float
) -> Turns:
    """Return x_k = φ₂ − i (φ₁ + 2πk), rad, for every turn k, which is the last axis.

    Whole turns are added to x_k so that it lies within half a turn of the middle of the gap.
    `driving` and `driven` are φ₁ and φ₂ in rad modulo one turn, `lower` and `upper` the TE of the
    flanks at every turn in rad, and `ratio` is i.
    """
    first, second = (np.asarray(angle)[..., None] for angle in (driving, driven))
    middle = (lower + upper) / 2
    distance = second - ratio * (first + REV * np.arange(middle.shape[-1])) - middle
    return middle + distance - REV * np.round(distance / REV)


def turn_log_likelihood(remainder: Turns, lower: Turns, upper: Turns, std: float) -> Turns:
    """Return ln p(x_k | k) of every turn: a uniform density of the gap convolved with a Gaussian.

    Arguments are in rad: `remainder` is x_k, `lower` and `upper` are TE_A and TE_B at every turn,
    `std` is the standard deviation of x_k. For a gap of width zero the density is the Gaussian.
    `softmax` over the last axis gives the probability of every turn. A negative backlash counts as
    a gap of its absolute width.
    """
    first, second = (remainder - lower) / std, (remainder - upper) / std
    high, low = np.maximum(first, second), np.minimum(first, second)
    # The lower tail is used, because near 1 the difference of two distribution functions is lost in
    # rounding.
    mirrored = high + low > 0
    high, low = np.where(mirrored, -low, high), np.where(mirrored, -high, low)
    middle, width = (high + low) / 2, high - low
    point = width * np.maximum(1.0, np.abs(middle)) < _NARROW
    low = np.where(point, high - 1.0, low)
    top = log_ndtr(high)
    gap = top + np.log1p(-np.exp(log_ndtr(low) - top)) - np.log(np.where(point, 1.0, width))
    return np.where(point, -(middle**2) / 2 - np.log(np.sqrt(REV)), gap) - np.log(std)


def _flanks(
    transmission_error: FlankModel | tuple[float, float], angles: Float[np.ndarray, " turns"]
) -> tuple[Float[np.ndarray, " turns"], Float[np.ndarray, " turns"]]:
    """Return TE_A and TE_B at driving angles, rad."""
    if isinstance(transmission_error, FlankModel):
        lower, upper = (
            np.asarray(transmission_error.transmission_error(angles, flank)) for flank in ("A", "B")
        )
    else:
        lower, upper = (np.full(len(angles), float(te)) for te in transmission_error)
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()):
        raise ValueError(
            "Argument `transmission_error` must be known on both flanks, but a value is not finite."
        )
    return lower, upper


def _require_possible(driving_rad: float, driven_rad: float, std_rad: float, turns: int) -> None:
    """Raise an error for angles that are not finite, an invalid `std_rad` and too many turns."""
    if not (np.isfinite(driving_rad) and np.isfinite(driven_rad)):
        raise ValueError(
            "Arguments `driving_rad` and `driven_rad` must be finite, but are"
            f" {driving_rad} and {driven_rad}."
        )
    if not (std_rad > 0 and np.isfinite(std_rad)):
        raise ValueError(f"Argument `std_rad` must be positive and finite, but is {std_rad}.")
    if turns > _MOST_TURNS:
        raise NoAnswerError(
            f"in a hunting period of {turns} turns the driven angles of two turns differ by"
            f" {360 * 3600 / turns:.2g}″, which no encoder resolves; give the ratio as a quotient"
            ' of tooth numbers, such as "7/1798".'
        )
