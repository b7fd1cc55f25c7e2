"""Random rigs from the prior of a scenario, with their noise and their encoder readings."""

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
from .scenarios import Scenario, columns_of, driving_angles, row_size, terms_of


def ar_noise(
    key: PRNGKeyArray, count: int, correlation: Float[Array, ""]
) -> Float[Array, " count"]:
    """Return `count` samples of stationary noise x_t = ρ x_{t−1} + √(1 − ρ²) w_t of unit variance.

    ρ is `correlation`, and w_t is white noise. The samples are divided into blocks of m ≈ √count.
    Within all blocks the recursion is one matrix product with the powers of ρ; the last samples of
    the blocks follow the same recursion with ρᵐ.
    """
    size = int(np.ceil(np.sqrt(count)))
    shocks = jax.random.normal(key, (size, size))
    scale = jnp.full((size, size), jnp.sqrt(1 - correlation**2)).at[0, 0].set(1.0)
    inside = (scale * shocks) @ _powers(correlation, size).T
    ends = _powers(correlation**size, size) @ inside[:, -1]
    before = jnp.concatenate([jnp.zeros(1), ends[:-1]])
    carried = before[:, None] * correlation ** np.arange(1, size + 1)[None]
    return (inside + carried).ravel()[:count]


def _powers(base: Float[Array, ""], size: int) -> Float[Array, "size size"]:
    """Return the lower triangular matrix with the elements base^(row − column)."""
    distance = np.subtract.outer(np.arange(size), np.arange(size))
    return jnp.where(distance >= 0, base ** np.maximum(distance, 0.0), 0.0)


LARGEST_ECCENTRICITY_MM = 0.03  # largest eccentricity of each gear (chosen)
BACKLASH_DEG = (0.065, 0.12)
"""Range of the constant backlash, ° (chosen): large enough that the gap of every rig stays open."""

MISSING: Term = (0, 2)
"""Order that a scenario with `missing` adds to the rig but not to the fit: driven order 2, which
has 1.125 cycles per driving turn, close to the first driving order."""

_ITERATIONS = 3
"""Number of iterations of the transmission error (chosen); each gains three digits."""


class Rig(NamedTuple):
    """True values of one rig, mm and rad.

    Eccentricities and encoder errors are complex: x + jy = amplitude · exp(j phase). `cosine` and
    `sine` are the coefficients of the further orders on flanks A and B.
    """

    driving: Complex[Array, ""]
    driven: Complex[Array, ""]
    driving_encoder: Complex[Array, ""]
    driven_encoder: Complex[Array, ""]
    constant_backlash: Float[Array, ""]
    cosine: Float[Array, "2 terms"]
    sine: Float[Array, "2 terms"]


class Sizes(NamedTuple):
    """Numbers of a scenario that can change without a new compilation.

    **Arguments**
    - `noise_rad`: standard deviation of the noise of a sample.
    - `correlation`: correlation coefficient of the noise of neighbouring samples.
    - `encoder_rad`: amplitude of the first order of each encoder error; for errors drawn in a disc,
      the largest amplitude.
    - `missing_rad`: amplitude of the order that the fit omits.
    """

    noise_rad: Float[Array, ""]
    correlation: Float[Array, ""]
    encoder_rad: Float[Array, ""]
    missing_rad: Float[Array, ""]


class Readings(NamedTuple):
    """Encoder readings of every flank, rad.

    `clean` is the transmission error from the readings without noise and quantisation.
    """

    driving: Float[Array, "flanks n"]
    driven: Float[Array, "flanks n"]
    clean: Float[Array, "flanks n"]


def order_terms(scenario: Scenario) -> tuple[Term, ...]:
    """Return the higher orders of a rig: pitch, mesh, and the order that the fit omits."""
    plan = terms_of(scenario)
    free = plan.locked[1][: len(plan.free)]
    return (*free, *((MISSING,) if scenario.missing else ()))


def draw_rig(key: PRNGKeyArray, scenario: Scenario, sizes: Sizes) -> Rig:
    """Draw one random rig.

    Eccentricities are uniform in a disc, encoder errors uniform in a disc or on a ring, and the
    constant backlash and all phases are uniform in an interval. The pitch orders of a flank have
    Rayleigh amplitudes, scaled so that all together have the rms of the scenario, as in
    `rig.imperfections.random_orders`.
    """
    keys = jax.random.split(key, 6)
    driving, driven = (LARGEST_ECCENTRICITY_MM * _in_disc(k) for k in jax.random.split(keys[0]))
    draw = _in_disc if scenario.encoders == "disc" else _on_ring
    first, second = (sizes.encoder_rad * draw(k) for k in jax.random.split(keys[1]))
    low, high = BACKLASH_DEG
    gap = DEG * jax.random.uniform(keys[2], (), float, low, high)
    kinds = np.array([_order_kind(term, scenario) for term in order_terms(scenario)])
    shape = (2, len(kinds))
    rayleigh = jnp.sqrt(-2 * jnp.log(jax.random.uniform(keys[3], shape, float, 1e-300)))
    pitch = jnp.where(kinds == "pitch", rayleigh, 0.0)
    total = jnp.sum(pitch**2, axis=1, keepdims=True)
    pitch = pitch * scenario.pitch_rms_deg * DEG * jnp.sqrt(2 / jnp.where(total > 0, total, 1.0))
    amplitude = jnp.where(kinds == "mesh", scenario.mesh_deg * DEG, pitch)
    amplitude = jnp.where(kinds == "missing", sizes.missing_rad, amplitude)
    sine, cosine = sincos(jax.random.uniform(keys[4], shape, float, 0.0, REV))
    return Rig(
        driving=driving,
        driven=driven,
        driving_encoder=first,
        driven_encoder=second,
        constant_backlash=gap,
        cosine=amplitude * sine,
        sine=amplitude * cosine,
    )


def encoder_readings(
    rig: Rig,
    key: PRNGKeyArray,
    scenario: Scenario,
    sizes: Sizes,
    driving: Float[Array, "flanks n"],
) -> Readings:
    """Return the readings of both encoders of a rig at the true driving angles `driving`, rad.

    The driven shaft follows the exact relation. The noise is added to the driven reading only. If
    the scenario has `counts_per_rev`, both readings are rounded to counts.
    """
    ratio = float(scenario.pair.ratio)
    driven = ratio * driving + _transmission_errors(rig, scenario, driving)
    key, counters = jax.random.split(key)
    noise = [
        ar_noise(noise_key, driving.shape[1], sizes.correlation)
        for noise_key in jax.random.split(key, len(driving))
    ]
    shown = _reading(rig.driving_encoder, driving)
    clean = _reading(rig.driven_encoder, driven)
    noisy = clean + sizes.noise_rad * jnp.stack(noise)
    clean = clean - ratio * shown
    if scenario.counts_per_rev is not None:
        step = REV / scenario.counts_per_rev
        # The zero of a counter lies at a random place within a count.
        first, second = jax.random.uniform(counters, (2,))
        shown, noisy = (
            step * jnp.floor(part / step + at) for part, at in ((shown, first), (noisy, second))
        )
    return Readings(shown, noisy, clean)


def _transmission_errors(
    rig: Rig, scenario: Scenario, driving: Float[Array, "flanks n"]
) -> Float[Array, "flanks n"]:
    """Return the true transmission error of every flank, TE = f(φ₁, i φ₁ + TE), by iteration."""
    model, ratio = _contact_model(rig, scenario), float(scenario.pair.ratio)

    def improved(_, error):
        return jnp.stack(
            [
                model.at_both_angles(angle, ratio * angle + flank_error, flank)
                for angle, flank_error, flank in zip(driving, error, scenario.flanks, strict=True)
            ]
        )

    start = [rig.constant_backlash if flank == "B" else 0.0 for flank in scenario.flanks]
    start = jnp.stack([jnp.full(driving.shape[1], value) for value in start])
    return jax.lax.fori_loop(0, _ITERATIONS, improved, start)


def truth_of(rig: Rig, names: tuple[str, ...]) -> Float[Array, " p"]:
    """Return the true values of the parameters `names` of a forward model; offsets are 0."""
    values = {"constant_backlash": rig.constant_backlash}
    for source in ("driving", "driven", "driving_encoder", "driven_encoder"):
        value = getattr(rig, source)
        values |= {f"{source}_x": value.real, f"{source}_y": value.imag}
    return jnp.stack([values.get(name, jnp.zeros(())) for name in names])


def _contact_model(rig: Rig, scenario: Scenario) -> CombinedModel:
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


def _reading(error: Complex[Array, ""], angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return the encoder reading φ + E sin(φ + ε) at the angle φ, for error = E exp(jε), rad."""
    sine, cosine = sincos(angle)
    return angle + error.real * sine + error.imag * cosine


def _in_disc(key: PRNGKeyArray) -> Complex[Array, ""]:
    """Return a random point of the unit disc, with uniform density over its area."""
    radius, turn = jax.random.uniform(key, (2,))
    return jnp.sqrt(radius) * jnp.exp(1j * REV * turn)


def _on_ring(key: PRNGKeyArray) -> Complex[Array, ""]:
    return jnp.exp(1j * REV * jax.random.uniform(key))


def _order_kind(term: Term, scenario: Scenario) -> str:
    if scenario.missing and term == MISSING:
        return "missing"
    return "mesh" if term[0] and term[0] % scenario.pair.driving.teeth == 0 else "pitch"


def missing_amplitude(scenario: Scenario) -> float:
    """Return the amplitude, rad, of the order that the fit omits.

    It is `missing` times the standard error of one coefficient (cosine or sine) of this order in a
    fit that includes it, with separate coefficients of every harmonic on each flank.
    """
    if not scenario.missing:
        return 0.0
    size, columns = row_size(scenario), columns_of(terms_of(scenario))
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
