"""Both flanks as harmonic series in the shaft angles: the limits of the driven gear in the gap.

A reversal is simulated in the offset x = φ₂ − i φ₁. Flank A is its lower bound, flank B the upper
(s is the axial displacement):

    TE_A(φ₁) + s tan β_L/R₂  ≤  x  ≤  TE_B(φ₁) − s tan β_R/R₂

An exact flank model is implicit in φ₂ and too slow inside a scan. In contact the TE is a function
of φ₁ alone, with harmonics of n₁ + n₂ i cycles per driving turn, so it is expanded once as

    TE_f(φ₁) = Re Σ_t c_ft exp(j (n₁ φ₁ + n₂ i φ₁))

Each evaluation then costs one sincos of φ₁ and one of i φ₁ for any number of harmonics.
"""

import itertools
from typing import Any

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

_NEGLIGIBLE = 1e-12
"""Coefficient, rad, up to which a harmonic is omitted if `highest` is given; a chosen tolerance."""

_TRUNCATION = 5e-10
"""Largest sum of the amplitudes of all omitted harmonics, rad, by default; a chosen tolerance."""

_HIGHEST = 6
"""Default for the highest order of each shaft; higher orders of eccentric gears are negligible."""


class Flanks(eqx.Module):
    """TE on flank A (`lower`) and flank B (`upper`), rad, and their slopes dTE/dφ₁."""

    lower: Float[Array, "*shape"]
    upper: Float[Array, "*shape"]
    lower_slope: Float[Array, "*shape"]
    upper_slope: Float[Array, "*shape"]


class Bounds(eqx.Module):
    """Harmonics of both flanks in the driving angle.

    **Arguments**
    - `ratio`: i.
    - `offset`: mean TE of flanks A and B, rad.
    - `cosine`, `sine`: coefficients of cos and sin (n₁ φ₁ + n₂ i φ₁), rad, shape (2, terms).
    - `closing`: tan β_L/R₂ and tan β_R/R₂, rad/mm: TE change per axial displacement, upwards on
      flank A and downwards on flank B.
    - `terms`: (n₁, n₂) of every harmonic.
    """

    ratio: Float[Numbers, ""] = eqx.field(converter=float64)
    offset: Float[Numbers, "2"] = eqx.field(converter=float64)
    cosine: Float[Numbers, "2 terms"] = eqx.field(converter=float64)
    sine: Float[Numbers, "2 terms"] = eqx.field(converter=float64)
    closing: Float[Numbers, "2"] = eqx.field(converter=float64)
    terms: tuple[Term, ...] = eqx.field(static=True)

    def at(self, driving_angle: Float[Array, "*shape"]) -> Flanks:
        """Return both flanks at a driving angle (rad) for an axial displacement of zero."""
        ratio = jnp.asarray(self.ratio)
        waves = _waves(self.terms, driving_angle, ratio * driving_angle)
        cosine, sine, offset = (jnp.asarray(c) for c in (self.cosine, self.sine, self.offset))
        cycles = jnp.asarray([first + second * ratio for first, second in self.terms])
        return Flanks(
            *(flank + _sum(c, s, waves) for flank, c, s in zip(offset, cosine, sine, strict=True)),
            *(_sum(cycles * s, -cycles * c, waves) for c, s in zip(cosine, sine, strict=True)),
        )

    def gap(self, driving_angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the backlash j = TE_B − TE_A (rad) at a driving angle (rad) for s = 0."""
        waves = _waves(self.terms, driving_angle, jnp.asarray(self.ratio) * driving_angle)
        cosine, sine, offset = (
            jnp.asarray(c)[1] - jnp.asarray(c)[0] for c in (self.cosine, self.sine, self.offset)
        )
        return offset + _sum(cosine, sine, waves)

    def turned(self, turns: int) -> "Bounds":
        """Return flanks whose values at φ₁ are those of these flanks at φ₁ + 2π · `turns`."""
        cycles = np.array([first + second * float(self.ratio) for first, second in self.terms])
        phasor: Any = (self.cosine - 1j * self.sine) * np.exp(2j * np.pi * cycles * turns)
        return Bounds(
            ratio=self.ratio,
            offset=self.offset,
            cosine=phasor.real,
            sine=-phasor.imag,
            closing=self.closing,
            terms=self.terms,
        )

    @property
    def closing_sum(self) -> Float[Array, ""]:
        """Decrease of the backlash per axial displacement, rad/mm; see equation (16)."""
        return jnp.sum(jnp.asarray(self.closing))


def bounds_of(
    model: FlankModel,
    closing: Float[Numbers, "2"],
    highest: tuple[int, int] | None = None,
) -> Bounds:
    """Expand a closed or implicit flank model into harmonics.

    The transmission error is a periodic function of each shaft angle. Its two-dimensional Fourier
    series, computed on enough points, is exact to rounding.

    **Arguments**
    - `closing`: see `Bounds`.
    - `highest`: highest order of each shaft; all harmonics above 1e-12 rad are kept. By default the
      harmonics with |n₁| + |n₂| ≤ n are kept, where n is the smallest number for which the omitted
      harmonics sum up to at most 5e-10 rad. n is 2 for rigs like that of the paper, which therefore
      share one compiled program.

    **Raises** `ValueError` for a model that is neither closed nor implicit.
    """
    if isinstance(model, ClosedModel):
        phasors: Any = np.stack([model.driving_phasor, model.driven_phasor], axis=1)
        return Bounds(
            ratio=model.ratio,
            offset=model.offset,
            cosine=phasors.imag,
            sine=phasors.real,
            closing=closing,
            terms=((1, 0), (0, 1)),
        )
    if not isinstance(model, ImplicitModel):
        raise ValueError(
            f"Argument `model` must be a closed or implicit flank model, but is {type(model)}."
        )
    spectrum: Any = _spectrum(model, highest or (_HIGHEST, _HIGHEST))
    if highest:
        strong = [term for term in _half_plane(highest) if _strength(spectrum, term) > _NEGLIGIBLE]
        terms = tuple(strong)
    else:
        terms = _by_total_order(spectrum)
    kept: Any = np.stack([spectrum[:, first, second] for first, second in terms], axis=1)
    return Bounds(
        ratio=model.ratio,
        offset=spectrum[:, 0, 0].real,
        cosine=2 * kept.real,
        sine=-2 * kept.imag,
        closing=closing,
        terms=terms,
    )


def _spectrum(model: ImplicitModel, highest: tuple[int, int]) -> Complex[np.ndarray, "2 n1 n2"]:
    """Return the Fourier coefficients (rad) of both flanks in both angles.

    The indices are flank, n₁ and n₂; negative orders stand at the end of an axis, as in an FFT.
    """
    counts = [4 * order + 4 for order in highest]
    first, second = np.meshgrid(
        *(2 * np.pi * np.arange(count) / count for count in counts), indexing="ij"
    )
    values = [np.asarray(step((model, first, second))) for step in (_on_torus_a, _on_torus_b)]
    return np.fft.fft2(np.stack(values)) / (counts[0] * counts[1])


def _half_plane(highest: tuple[int, int]) -> list[Term]:
    """Return all pairs (n₁, n₂) of orders up to `highest` without (0, 0).

    Of (n₁, n₂) and (−n₁, −n₂), which are the same harmonic, only one is listed.
    """
    orders = itertools.product(range(highest[0] + 1), range(-highest[1], highest[1] + 1))
    return [(first, second) for first, second in orders if first > 0 or second > 0]


def _by_total_order(spectrum: Any) -> tuple[Term, ...]:
    """Return all harmonics with |n₁| + |n₂| ≤ n, for the smallest n within `_TRUNCATION`."""
    terms = _half_plane((_HIGHEST, _HIGHEST))
    for highest in range(1, 2 * _HIGHEST):
        beyond = [term for term in terms if abs(term[0]) + abs(term[1]) > highest]
        if 2 * sum(_strength(spectrum, term) for term in beyond) <= _TRUNCATION:
            return tuple(term for term in terms if term not in beyond)
    return tuple(terms)


def _strength(spectrum: Any, term: Term) -> float:
    """Return the larger of the coefficients of a harmonic on both flanks, rad.

    The coefficient is half the amplitude of the harmonic.
    """
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
    """Return (sin, cos) of n₁ `driving` + n₂ `driven` (rad) for all terms (n₁, n₂).

    The function uses angle addition, so it computes only one sincos per shaft.
    """
    powers = ({0: None, 1: sincos(driving)}, {0: None, 1: sincos(driven)})
    return [_times(_power(powers[0], first), _power(powers[1], second)) for first, second in terms]


def _sum(cosine: Array, sine: Array, waves: list[Any]) -> Array:
    """Return the sum of cosine · cos + sine · sin over all harmonics; `waves` are (sin, cos)."""
    total = jnp.zeros(())
    for index, (wave_sine, wave_cosine) in enumerate(waves):
        total = total + (cosine[index] * wave_cosine + sine[index] * wave_sine)
    return total


def _power(powers: dict, order: int):
    """Return (sin, cos) of `order` · α by angle addition; None for order 0.

    `powers` maps orders to known results. At the start it must hold {0: None, 1: (sin α, cos α)};
    results for further positive orders are stored in it. A negative order negates the sine.
    """
    if order < 0:
        sine, cosine = _power(powers, -order)
        return -sine, cosine
    if order not in powers:
        powers[order] = _times(_power(powers, order // 2), _power(powers, order - order // 2))
    return powers[order]


def _times(first, second):
    """Return (sin, cos) of the sum of two angles, given (sin, cos) of both; None is angle zero."""
    if first is None or second is None:
        return first or second
    return (
        first[0] * second[1] + first[1] * second[0],
        first[1] * second[1] - first[0] * second[0],
    )
