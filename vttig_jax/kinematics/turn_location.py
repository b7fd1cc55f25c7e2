"""Where in the hunting period a pair stands, from one reading of each shaft within its turn.

The backlash is a function of φ₁ over the hunting period, an encoder of one turn knows φ₁ modulo one
turn. The driven shaft tells the rest: at φ₁ = θ₁ + 2πk it stands at i φ₁ + TE, and over the n turns
of the period i·2πk takes n values 2π/n apart. The turn is the k whose remainder

    x_k = φ₂ − i (θ₁ + 2πk)    (modulo 2π)

lies where a transmission error of this pair can.
"""

from dataclasses import dataclass
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..base.errors import NoAnswerError
from ..base.files.text_tables import key_values
from ..base.runtime import require_x64
from ..base.units import ARCSEC, DEG, REV
from ..pair.gear_pair import Flank
from .flank_model import FlankModel, flank_index

FARTHEST = 6.0
"""Standard deviations off the flanks beyond which readings fit no turn at all."""

TITLE = "place in the hunting period"

_NARROW = 1e-4
"""Width of the gap, in standard deviations, below which it counts as a point."""

_MOST_TURNS = 2**20


@dataclass(frozen=True)
class Located:
    """The turn within the hunting period.

    **Arguments**
    - `turn`: 0 … hunting turns − 1, counted from φ₁ = 0.
    - `probability`: of that turn among all, which are equally probable beforehand.
    - `driving_rad`: φ₁ in [0, 2π hunting turns).
    - `runner_up`, `runner_up_probability`: the next probable turn; None and 0 for a period of one.
    - `misfit_rad`: how far the driven shaft is outside the gap, or off the flank that is known.
    - `std_rad`: standard deviation of φ₂ − i φ₁ that was reckoned with.
    - `probabilities`: of every turn, shape (hunting turns,).
    - `flank`: the one in contact, where that is known.
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
        """Turns of the driving shaft in the hunting period."""
        return len(self.probabilities)

    @property
    def fits(self) -> bool:
        """False where the readings stand off even the best turn by six standard deviations.

        The probabilities compare the turns with one another; they say nothing about readings that
        no turn explains, of another pair, another zero or after a slip.
        """
        return self.misfit_rad <= FARTHEST * self.std_rad

    def rows(self) -> list[tuple[str, str]]:
        """Names and values as they are printed."""
        rows = [
            ("turn", f"{self.turn} of 0 … {self.hunting_turns - 1}"),
            ("driving angle", f"{self.driving_rad / DEG:.4f}° of {360 * self.hunting_turns}°"),
            ("probability", f"{self.probability:.6g}"),
        ]
        if self.runner_up is not None:
            rows.append(
                (
                    "runner-up",
                    f"turn {self.runner_up}, probability {self.runner_up_probability:.2g}",
                )
            )
        off = f"{self.misfit_rad / ARCSEC:.4g}″"
        if self.flank is not None:
            found = f"{off} off flank {self.flank}"
        else:
            found = f"{off} outside the gap" if self.misfit_rad else "within the gap"
        rows.append(("driven shaft", f"{found}; readings good to {self.std_rad / ARCSEC:.3g}″"))
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
    """The turn within the hunting period from single-turn readings of both shafts.

    Where a turn is right, the driven shaft stands between flank A and B at the angle of that turn:

        p(x_k | k) = ∫ N(x_k − t; std) dt / (TE_B − TE_A)    over t from TE_A(φ₁) to TE_B(φ₁)

    Uniform over the gap, ends included, because a shaft at rest may lie anywhere in it and nothing
    tells where; a drive that runs is on a flank, p = N(x_k − TE_f; std), and `flank` says on which.
    For the turns of a pair whose angles stand farther apart than gap and noise together the two
    give the same answer.

    **Arguments**
    - `driving_rad`, `driven_rad`: φ₁ and φ₂ modulo one turn, from the zeros of the model.
    - `ratio`: i, driven over driving speed; its denominator is the number of turns.
    - `transmission_error`: a flank model as measured, which gives TE_A and TE_B at every turn; or
      both as two constants, (0, backlash) for a pair of which only that is known.
    - `std_rad`: standard deviation of φ₂ − i φ₁ about the model, rad of the driven shaft: √(σ₂² +
      i²σ₁²) for readings good to σ₁ and σ₂.
    - `flank`: the flank in contact, where it is known.

    **Raises** `ValueError` for readings that are no numbers and for a `std_rad` that is not
    positive, `NoAnswerError` for a period of more than 2²⁰ turns.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from fractions import Fraction
    >>> from vttig_jax.kinematics import locate
    >>> vttig_jax.enable_x64()
    >>> turn, within = 5, math.radians(123.4)
    >>> driven = 45 / 80 * (2 * math.pi * turn + within) + math.radians(0.02)
    >>> gap = 0.0, math.radians(0.04)
    >>> found = locate(within, driven % (2 * math.pi), Fraction(45, 80), gap, std_rad=1e-3)
    >>> found.turn, round(found.probability, 6), round(math.degrees(found.driving_rad), 3)
    (5, 1.0, 1923.4)

    ```
    """
    require_x64("locate")
    turns = ratio.denominator
    _require_possible(driving_rad, driven_rad, std_rad, turns)
    within = float(np.mod(driving_rad, REV))
    within = 0.0 if within == REV else within
    candidates = within + REV * np.arange(turns)
    lower, upper = _flanks(transmission_error, candidates)
    if flank is not None:
        lower = upper = (lower, upper)[flank_index(flank)]
    remainder = turn_remainders(within, driven_rad, lower, upper, float(ratio))
    likelihood = turn_log_likelihood(remainder, lower, upper, std_rad)
    chance = np.asarray(jax.nn.softmax(likelihood))
    order = np.argsort(-np.asarray(likelihood), kind="stable")
    best = int(order[0])
    low, high = sorted((float(lower[best]), float(upper[best])))
    place = float(remainder[best])
    return Located(
        turn=best,
        probability=float(chance[best]),
        driving_rad=float(candidates[best]),
        runner_up=int(order[1]) if turns > 1 else None,
        runner_up_probability=float(chance[order[1]]) if turns > 1 else 0.0,
        misfit_rad=max(0.0, low - place, place - high),
        std_rad=float(std_rad),
        probabilities=chance,
        flank=flank,
    )


def turn_remainders(
    driving: Real[ArrayLike, "*shape"],
    driven: Real[ArrayLike, "*shape"],
    lower: Real[ArrayLike, "*#shape turns"],
    upper: Real[ArrayLike, "*#shape turns"],
    ratio: Real[ArrayLike, ""],
) -> Float[Array, "*shape turns"]:
    """x_k = φ₂ − i (φ₁ + 2πk) at every turn k, rad, by whole turns next to the middle of the gap.

    `driving`, `driven`: φ₁ and φ₂ in rad modulo one turn. `lower`, `upper`: TE of the flanks at
    every turn. `ratio`: i.
    """
    middle = (jnp.asarray(lower, float) + jnp.asarray(upper, float)) / 2
    first, second = (jnp.asarray(angle, float)[..., None] for angle in (driving, driven))
    apart = second - ratio * (first + REV * jnp.arange(middle.shape[-1])) - middle
    return middle + apart - REV * jnp.round(apart / REV)


def turn_log_likelihood(
    remainder: Real[ArrayLike, "*shape turns"],
    lower: Real[ArrayLike, "*#shape turns"],
    upper: Real[ArrayLike, "*#shape turns"],
    std: Real[ArrayLike, ""],
) -> Float[Array, "*shape turns"]:
    """ln p(x_k | k) of every turn: uniform between the flanks, convolved with a Gaussian.

    Where the flanks meet it is the Gaussian itself. `softmax` over the last axis makes it the
    probability of every turn. Flanks that cross, a pair that binds, count as a gap of that width.
    """
    std, remainder = jnp.asarray(std, float), jnp.asarray(remainder, float)
    first, second = ((remainder - jnp.asarray(te, float)) / std for te in (lower, upper))
    high, low = jnp.maximum(first, second), jnp.minimum(first, second)
    # Both ends where the distribution function is small, or their difference would be rounding.
    flipped = high + low > 0
    high, low = jnp.where(flipped, -low, high), jnp.where(flipped, -high, low)
    middle, width = (high + low) / 2, high - low
    point = width * jnp.maximum(1.0, jnp.abs(middle)) < _NARROW
    low = jnp.where(point, high - 1.0, low)
    top = log_ndtr(high)
    between = top + jnp.log1p(-jnp.exp(log_ndtr(low) - top)) - jnp.log(jnp.where(point, 1.0, width))
    return jnp.where(point, -(middle**2) / 2 - np.log(np.sqrt(REV)), between) - jnp.log(std)


def _flanks(
    transmission_error: FlankModel | tuple[float, float], angles: Float[np.ndarray, " turns"]
) -> tuple[Float[np.ndarray, " turns"], Float[np.ndarray, " turns"]]:
    """TE_A and TE_B at driving angles, rad."""
    if isinstance(transmission_error, FlankModel):
        lower, upper = (
            np.asarray(transmission_error.transmission_error(angles, flank)) for flank in ("A", "B")
        )
    else:
        lower, upper = (np.full(len(angles), float(te)) for te in transmission_error)
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()):
        raise ValueError(
            "Argument `transmission_error` must be known on both flanks, but one is not a number."
        )
    return lower, upper


def _require_possible(driving_rad: float, driven_rad: float, std_rad: float, turns: int) -> None:
    """Refuse numbers that are none and periods that no encoder resolves."""
    if not (np.isfinite(driving_rad) and np.isfinite(driven_rad)):
        raise ValueError(
            "Arguments `driving_rad` and `driven_rad` must be finite, but are"
            f" {driving_rad} and {driven_rad}."
        )
    if not (std_rad > 0 and np.isfinite(std_rad)):
        raise ValueError(f"Argument `std_rad` must be positive and finite, but is {std_rad}.")
    if turns > _MOST_TURNS:
        raise NoAnswerError(
            f"a hunting period of {turns} turns leaves {360 * 3600 / turns:.2g}″ between the driven"
            " angles of two turns, too little for any encoder; give the ratio as a quotient of"
            ' tooth numbers, such as "7/1798".'
        )
