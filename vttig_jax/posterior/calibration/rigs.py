"""Rigs drawn from the prior of a scenario, their stationary noise, and what their encoders read."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, PRNGKeyArray

from ...base.numerics.sincos import sincos
from ...base.units import DEG, REV
from ...kinematics.exact import ExactModel
from ...kinematics.harmonic import CombinedModel, OrderModel, Term
from ..planning.noise import PlannedNoise
from .scenarios import Scenario, columns_of, driving_angles, planned, row_size


def ar_noise(
    key: PRNGKeyArray, count: int, correlation: Float[Array, ""]
) -> Float[Array, " count"]:
    """x_t = ρ x_{t−1} + √(1 − ρ²) w_t of unit variance, from its stationary start.

    The recursion is linear: within pieces of m ≈ √n samples it is one product with the triangle
    of the powers of ρ, and the ends of the pieces follow from each other the same way with ρᵐ.
    """
    size = int(np.ceil(np.sqrt(count)))
    shocks = jax.random.normal(key, (size, size))
    scale = jnp.full((size, size), jnp.sqrt(1 - correlation**2)).at[0, 0].set(1.0)
    inside = (scale * shocks) @ _powers(correlation, size).T
    ends = _powers(correlation**size, size) @ inside[:, -1]
    before = jnp.concatenate([jnp.zeros(1), ends[:-1]])
    carried = before[:, None] * correlation ** np.arange(1, size + 1)
    return (inside + carried).ravel()[:count]


def _powers(base: Float[Array, ""], size: int) -> Float[Array, "size size"]:
    """Lower triangle of base^(row − column)."""
    distance = np.subtract.outer(np.arange(size), np.arange(size))
    return jnp.where(distance >= 0, base ** np.maximum(distance, 0.0), 0.0)


LARGEST_ECCENTRICITY_MM = 0.03
BACKLASH_DEG = (0.065, 0.12)
"""Constant backlash: with eccentricities of 0.03 mm and the orders of a rig the gap stays open."""

MISSING: Term = (0, 2)
"""The order that `missing` adds: 1.125 cycles a driving turn, close to the first driving order."""

_ITERATIONS = 3
"""Each gains three digits on the constant backlash, 1e-3 rad."""


class Rig(NamedTuple):
    """The truth of one rig: mm and rad; x + jy = amplitude · exp(j phase)."""

    driving: Complex[Array, ""]
    driven: Complex[Array, ""]
    driving_encoder: Complex[Array, ""]
    driven_encoder: Complex[Array, ""]
    constant_backlash: Float[Array, ""]
    cosine: Float[Array, "2 terms"]
    sine: Float[Array, "2 terms"]


class Sizes(NamedTuple):
    """Numbers of a scenario that need no compilation of their own.

    **Arguments**
    - `noise_rad`, `correlation`: of a sample, and between neighbouring samples.
    - `encoder_rad`: size of the encoder errors.
    - `missing_rad`: amplitude of the order that is left out of the fit.
    """

    noise_rad: Float[Array, ""]
    correlation: Float[Array, ""]
    encoder_rad: Float[Array, ""]
    missing_rad: Float[Array, ""]


class Readings(NamedTuple):
    """What the encoders show, and the transmission error without noise and counts; rad."""

    driving: Float[Array, "flanks n"]
    driven: Float[Array, "flanks n"]
    clean: Float[Array, "flanks n"]


def order_terms(scenario: Scenario) -> tuple[Term, ...]:
    """Orders a rig has beside the first: pitch, mesh, and the one that the fit leaves out."""
    free = tuple(h.term for h in planned(scenario).free)
    return (*free, *((MISSING,) if scenario.missing else ()))


def draw_rig(key: PRNGKeyArray, scenario: Scenario, sizes: Sizes) -> Rig:
    """One rig: offsets flat in a disc, constant backlash flat, phases uniform.

    Pitch orders have Rayleigh amplitudes that together have the rms of the scenario, flank by
    flank, as those of `rig.imperfections.random_orders`.
    """
    keys = jax.random.split(key, 6)
    driving, driven = (LARGEST_ECCENTRICITY_MM * _in_disc(k) for k in jax.random.split(keys[0]))
    draw = _in_disc if scenario.encoders == "disc" else _on_ring
    first, second = (sizes.encoder_rad * draw(k) for k in jax.random.split(keys[1]))
    low, high = BACKLASH_DEG
    gap = DEG * jax.random.uniform(keys[2], (), float, low, high)
    kinds = np.array([_kind(term, scenario) for term in order_terms(scenario)])
    shape = (2, len(kinds))
    rayleigh = jnp.sqrt(-2 * jnp.log(jax.random.uniform(keys[3], shape, float, 1e-300)))
    pitch = jnp.where(kinds == "pitch", rayleigh, 0.0)
    total = jnp.sum(pitch**2, axis=1, keepdims=True)
    pitch = pitch * scenario.pitch_rms_deg * DEG * jnp.sqrt(2 / jnp.where(total > 0, total, 1.0))
    amplitude = jnp.where(kinds == "mesh", scenario.mesh_deg * DEG, pitch)
    amplitude = jnp.where(kinds == "missing", sizes.missing_rad, amplitude)
    sine, cosine = sincos(jax.random.uniform(keys[4], shape, float, 0.0, REV))
    return Rig(driving, driven, first, second, gap, amplitude * sine, amplitude * cosine)


def read(
    rig: Rig,
    key: PRNGKeyArray,
    scenario: Scenario,
    sizes: Sizes,
    driving: Float[Array, "flanks n"],
) -> Readings:
    """What the encoders of a rig read while its driving shaft stands at the true angles `driving`.

    The driven shaft follows through the exact relation; the noise is on the driven reading.
    """
    ratio = float(scenario.pair.ratio)
    driven = ratio * driving + _errors(rig, scenario, driving)
    key, counters = jax.random.split(key)
    noise = [
        ar_noise(own, driving.shape[1], sizes.correlation)
        for own in jax.random.split(key, len(driving))
    ]
    shown, clean = _shown(rig.driving_encoder, driving), _shown(rig.driven_encoder, driven)
    noisy = clean + sizes.noise_rad * jnp.stack(noise)
    clean = clean - ratio * shown
    if scenario.counts_per_rev is not None:
        step = REV / scenario.counts_per_rev
        # Where within a count a counter was set to zero is chance.
        first, second = jax.random.uniform(counters, (2,))
        shown, noisy = (
            step * jnp.floor(part / step + at) for part, at in ((shown, first), (noisy, second))
        )
    return Readings(shown, noisy, clean)


def _errors(
    rig: Rig, scenario: Scenario, driving: Float[Array, "flanks n"]
) -> Float[Array, "flanks n"]:
    """True transmission error of every flank: TE = f(φ₁, i φ₁ + TE) by iteration."""
    model, ratio = _contact(rig, scenario), float(scenario.pair.ratio)

    def nearer(_, error):
        return jnp.stack(
            [
                model.at_both_angles(angle, ratio * angle + own, flank)
                for angle, own, flank in zip(driving, error, scenario.flanks, strict=True)
            ]
        )

    start = [rig.constant_backlash if flank == "B" else 0.0 for flank in scenario.flanks]
    start = jnp.stack([jnp.full(driving.shape[1], value) for value in start])
    return jax.lax.fori_loop(0, _ITERATIONS, nearer, start)


def truth_of(rig: Rig, names: tuple[str, ...]) -> Float[Array, " p"]:
    """True values of the parameters of a relation by name; 0 for offsets, which nobody asks for."""
    known = {"constant_backlash": rig.constant_backlash}
    for source in ("driving", "driven", "driving_encoder", "driven_encoder"):
        value = getattr(rig, source)
        known |= {f"{source}_x": value.real, f"{source}_y": value.imag}
    return jnp.stack([known.get(name, jnp.zeros(())) for name in names])


def _contact(rig: Rig, scenario: Scenario) -> CombinedModel:
    pair = scenario.pair
    ratio = jnp.asarray(float(pair.ratio))
    exact = ExactModel(
        ratio=ratio,
        centre_distance=jnp.asarray(pair.centre_distance_mm),
        base_sum=pair.base_radii.sum(axis=0),
        driving_offset=rig.driving,
        driven_offset=rig.driven,
        offset=jnp.stack([jnp.zeros(()), rig.constant_backlash]),
    )
    orders = OrderModel(
        ratio=ratio,
        terms=order_terms(scenario),
        offset=jnp.zeros(2),
        cosine=rig.cosine,
        sine=rig.sine,
    )
    return CombinedModel(ratio, exact, orders)


def _shown(error: Complex[Array, ""], angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """φ + E sin(φ + ε)."""
    sine, cosine = sincos(angle)
    return angle + error.real * sine + error.imag * cosine


def _in_disc(key: PRNGKeyArray) -> Complex[Array, ""]:
    """A point of the unit disc, all places alike."""
    radius, turn = jax.random.uniform(key, (2,))
    return jnp.sqrt(radius) * jnp.exp(1j * REV * turn)


def _on_ring(key: PRNGKeyArray) -> Complex[Array, ""]:
    return jnp.exp(1j * REV * jax.random.uniform(key))


def _kind(term: Term, scenario: Scenario) -> str:
    if scenario.missing and term == MISSING:
        return "missing"
    return "mesh" if term[0] and term[0] % scenario.pair.driving.teeth == 0 else "pitch"


def missing_amplitude(scenario: Scenario) -> float:
    """Amplitude of the order the fit leaves out, rad: `missing` standard errors of one quadrature.

    The standard error is the one it would have if it were fitted along, every harmonic with a
    coefficient of its own on each flank, which is what two eccentricities and two encoders come to.
    """
    if not scenario.missing:
        return 0.0
    size, columns = row_size(scenario), columns_of(planned(scenario))
    noise = PlannedNoise(scenario.noise_std_deg, scenario.correlation_s)
    blocks = noise.of_blocks(size, scenario.rate_hz)
    driving = driving_angles(scenario)[0]
    orders = np.array([*columns.free, *columns.tied[:2], MISSING], np.float64)
    driven = float(scenario.pair.ratio) * driving
    phase = orders[:, :1] * driving + orders[:, 1:] * driven
    samples = np.concatenate([np.ones((1, len(driving))), np.cos(phase), np.sin(phase)])
    count = samples.shape[1] // size
    rows = samples[:, : count * size].reshape(len(samples), count, size).mean(axis=2).T
    white = blocks.whitened(rows)
    covariance = np.linalg.inv(white.T @ white)
    places = [len(orders), 2 * len(orders)]
    return scenario.missing * float(np.sqrt(np.mean(covariance[places, places])))
