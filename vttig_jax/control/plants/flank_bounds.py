"""Where the driven gear may stand: the two flanks as harmonics of both shafts, with their slopes.

A reversal is simulated in the offset x = φ₂ − i φ₁, bounded by flank A from below, by B from above:

    TE_A(φ₁) + s tan β_L/R₂  ≤  x  ≤  TE_B(φ₁) − s tan β_R/R₂

An exact flank model is implicit in φ₂ and too slow for the inside of a scan. In contact it is a
function of φ₁ alone whose spectrum is known, n₁ + n₂ i cycles a turn, so it is written once as

    TE_f(φ₁) = Re Σ_t c_ft exp(j (n₁ φ₁ + n₂ i φ₁))

and from then on costs one sincos of φ₁ and one of i φ₁, whatever the number of harmonics.
"""

import itertools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ...base.arrays import Numbers, float64
from ...base.numerics.sincos import sincos
from ...kinematics.first_order import ClosedModel
from ...kinematics.flank_model import FlankModel, ImplicitModel, fixed_point
from ...kinematics.harmonic import Term

_LEAST = 1e-12
"""rad below which a harmonic is left out."""

_LEFT = 5e-10
"""rad that all harmonics left out by default may add up to."""

_HIGHEST = 6
"""Order of each shaft that is looked at by default: eccentricities of a gear reach no further."""


class Flanks(NamedTuple):
    """TE of flank A and B in rad, and their slopes dTE/dφ₁."""

    lower: Float[Array, "*shape"]
    upper: Float[Array, "*shape"]
    lower_slope: Float[Array, "*shape"]
    upper_slope: Float[Array, "*shape"]


class Bounds(eqx.Module):
    """Both flanks as harmonics of the driving angle.

    **Arguments**
    - `ratio`: i.
    - `offset`: mean TE of flank A and B, rad.
    - `cosine`, `sine`: rad, shape (2, terms), of cos and sin (n₁ φ₁ + n₂ i φ₁).
    - `closing`: rad of TE by which a mm of axial displacement moves flank A up and flank B down,
      tan β_L/R₂ and tan β_R/R₂.
    - `terms`: (n₁, n₂) of every harmonic.
    """

    ratio: Float[Numbers, ""] = eqx.field(converter=float64)
    offset: Float[Numbers, "2"] = eqx.field(converter=float64)
    cosine: Float[Numbers, "2 terms"] = eqx.field(converter=float64)
    sine: Float[Numbers, "2 terms"] = eqx.field(converter=float64)
    closing: Float[Numbers, "2"] = eqx.field(converter=float64)
    terms: tuple[Term, ...] = eqx.field(static=True)

    def at(self, driving_angle: Float[Array, "*shape"]) -> Flanks:
        """Both flanks at a driving angle, axial displacement zero."""
        ratio = jnp.asarray(self.ratio)
        waves = _waves(self.terms, driving_angle, ratio * driving_angle)
        cosine, sine, offset = (jnp.asarray(c) for c in (self.cosine, self.sine, self.offset))
        cycles = jnp.asarray([first + second * ratio for first, second in self.terms])
        return Flanks(
            *(flank + _sum(c, s, waves) for flank, c, s in zip(offset, cosine, sine, strict=True)),
            *(_sum(cycles * s, -cycles * c, waves) for c, s in zip(cosine, sine, strict=True)),
        )

    def gap(self, driving_angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Backlash j = TE_B − TE_A, rad, axial displacement zero."""
        waves = _waves(self.terms, driving_angle, jnp.asarray(self.ratio) * driving_angle)
        cosine, sine, offset = (
            jnp.asarray(c)[1] - jnp.asarray(c)[0] for c in (self.cosine, self.sine, self.offset)
        )
        return offset + _sum(cosine, sine, waves)

    def turned(self, turns: int) -> "Bounds":
        """The flanks as they are so many turns of the driving shaft later."""
        cycles = np.array([first + second * float(self.ratio) for first, second in self.terms])
        phasor: Any = (self.cosine - 1j * self.sine) * np.exp(2j * np.pi * cycles * turns)
        return Bounds(self.ratio, self.offset, phasor.real, -phasor.imag, self.closing, self.terms)

    @property
    def closing_sum(self) -> Float[Array, ""]:
        """rad of backlash that a mm of axial displacement takes up, (16)."""
        return jnp.sum(jnp.asarray(self.closing))


def bounds_of(
    model: FlankModel,
    closing: Float[Numbers, "2"],
    highest: tuple[int, int] | None = None,
) -> Bounds:
    """The harmonics of a closed or implicit flank model.

    On a torus of both angles the relation is periodic in each; its two-dimensional Fourier series
    on enough points is exact to rounding.

    **Arguments**
    - `highest`: order of each shaft up to which harmonics above 1e-12 rad are taken. By default
      all with |n₁| + |n₂| ≤ n are, n the least that leaves out 5e-10 rad at most: 2 for rigs as
      the paper's, so that such rigs share one compiled program.

    **Raises** `ValueError` for a model that is neither closed nor implicit.
    """
    if isinstance(model, ClosedModel):
        phasors: Any = np.stack([model.driving_phasor, model.driven_phasor], axis=1)
        return Bounds(
            model.ratio, model.offset, phasors.imag, phasors.real, closing, ((1, 0), (0, 1))
        )
    if not isinstance(model, ImplicitModel):
        raise ValueError(
            f"Argument `model` must be a closed or implicit flank model, but is {type(model)}."
        )
    spectrum: Any = _spectrum(model, highest or (_HIGHEST, _HIGHEST))
    if highest:
        strong = [term for term in _half_plane(highest) if _strength(spectrum, term) > _LEAST]
        terms = tuple(strong)
    else:
        terms = _mixed(spectrum)
    kept: Any = np.stack([spectrum[:, first, second] for first, second in terms], axis=1)
    return Bounds(
        model.ratio, spectrum[:, 0, 0].real, 2 * kept.real, -2 * kept.imag, closing, terms
    )


def _spectrum(model: ImplicitModel, most: tuple[int, int]) -> Complex[np.ndarray, "2 n1 n2"]:
    """Fourier coefficients over both angles, flank by flank; negative orders wrap around."""
    counts = [4 * order + 4 for order in most]
    first, second = np.meshgrid(
        *(2 * np.pi * np.arange(count) / count for count in counts), indexing="ij"
    )
    values = [np.asarray(step((model, first, second))) for step in (_on_torus_a, _on_torus_b)]
    return np.fft.fft2(np.stack(values)) / (counts[0] * counts[1])


def _half_plane(most: tuple[int, int]) -> list[Term]:
    """Orders of both shafts, without the constant and without those that only change the sign."""
    orders = itertools.product(range(most[0] + 1), range(-most[1], most[1] + 1))
    return [(first, second) for first, second in orders if first > 0 or second > 0]


def _mixed(spectrum: Any) -> tuple[Term, ...]:
    """All harmonics up to the least sum of both orders that leaves out little enough."""
    every = _half_plane((_HIGHEST, _HIGHEST))
    for highest in range(1, 2 * _HIGHEST):
        beyond = [term for term in every if abs(term[0]) + abs(term[1]) > highest]
        if 2 * sum(_strength(spectrum, term) for term in beyond) <= _LEFT:
            return tuple(term for term in every if term not in beyond)
    return tuple(every)


def _strength(spectrum: Any, term: Term) -> float:
    """Largest coefficient of a harmonic on either flank, half its amplitude, rad."""
    return float(np.abs(spectrum[:, term[0], term[1]]).max())


@jax.jit
def _on_torus_a(args):
    return fixed_point(_step_a, args)


@jax.jit
def _on_torus_b(args):
    return fixed_point(_step_b, args)


def _step_a(error, args):
    model, driving, ideal = args
    return model.at_both_angles(driving, ideal + error, "A")


def _step_b(error, args):
    model, driving, ideal = args
    return model.at_both_angles(driving, ideal + error, "B")


def _waves(terms: tuple[Term, ...], driving: Array, driven: Array) -> list[Any]:
    """(sin, cos) of every n₁ driving + n₂ driven from one sincos of each, by angle addition."""
    powers = ({0: None, 1: sincos(driving)}, {0: None, 1: sincos(driven)})
    return [_times(_power(powers[0], first), _power(powers[1], second)) for first, second in terms]


def _sum(cosine: Array, sine: Array, waves: list[Any]) -> Array:
    """Σ cosine cos + sine sin over the harmonics."""
    found = jnp.zeros(())
    for place, (wave_sine, wave_cosine) in enumerate(waves):
        found = found + (cosine[place] * wave_cosine + sine[place] * wave_sine)
    return found


def _power(known: dict, order: int):
    """(sin, cos) of `order` times the angle of known[1]; None for order 0, a turn by nothing."""
    if order < 0:
        sine, cosine = _power(known, -order)
        return -sine, cosine
    if order not in known:
        known[order] = _times(_power(known, order // 2), _power(known, order - order // 2))
    return known[order]


def _times(first, second):
    """(sin, cos) of a sum of two angles."""
    if first is None or second is None:
        return first or second
    return (
        first[0] * second[1] + first[1] * second[0],
        first[1] * second[1] - first[0] * second[0],
    )
