"""One million samples of both flanks: the arrays, the model and the truth that every row shares."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

import vttig_jax
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.identify.model.harmonics import TermPlan, plan_terms
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segment
from vttig_jax.pair.gear_pair import GearPair
from vttig_jax.pair.schema import LogLayout
from vttig_jax.rig.imperfections import Noise, quantised
from vttig_jax.rig.paper import paper_eccentricities, paper_pair

PER_FLANK = 500_000
HALVES = (slice(0, PER_FLANK), slice(PER_FLANK, 2 * PER_FLANK))
RATE_HZ = 1987.0
COUNTS = 90_000
ENCODERS_ARCSEC, ENCODER_PHASES_DEG = (18.0, 18.0), (200.0, 310.0)

Orders = tuple[tuple[int, ...], tuple[int, ...], int]
FIRST: Orders = ((1,), (1,), 0)
FULL: Orders = (tuple(range(1, 9)), tuple(range(1, 9)), 1)


@dataclass(frozen=True)
class Problem:
    """Samples of flank A, then of flank B, and the model of (19) and (20) with encoder terms.

        TE_A = K [e₁ sin(φ₁+θ₁+α) + e₂ sin(φ₂+θ₂−α)] + o_A + c + Σ free harmonics of flank A
        TE_B = K [e₁ sin(φ₁+θ₁−α) + e₂ sin(φ₂+θ₂+α)] + o_B + c + Σ free harmonics of flank B
        c    = E₂ sin(φ₂+ε₂) − i E₁ sin(φ₁+ε₁)

    `truth` holds e₁ cos θ₁, e₁ sin θ₁, e₂ cos θ₂, e₂ sin θ₂ in mm, o_A and o_B in arcsec and, with
    `encoders`, E₁ cos ε₁, E₁ sin ε₁, E₂ cos ε₂, E₂ sin ε₂ in arcsec.
    """

    pair: GearPair
    log: EncoderLog
    segments: tuple[Segment, Segment]
    terms: TermPlan
    encoders: bool
    truth: np.ndarray

    @cached_property
    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """φ₁ and φ₂ of all samples, rad."""
        return self.log.driving_angle, self.log.driven_angle

    @cached_property
    def error(self) -> np.ndarray:
        """Measured TE of all samples, arcsec."""
        return self.log.transmission_error / ARCSEC

    @property
    def free(self) -> tuple[tuple[int, int], ...]:
        """Orders (n₁, n₂) of the harmonics that are free on each flank."""
        return tuple(harmonic.term for harmonic in self.terms.free)

    def first_order(self, side: int) -> np.ndarray:
        """Matrix from the physical parameters to coefficients; see the function."""
        return first_order(self.pair, side, encoders=self.encoders)

    def without_caches(self) -> EncoderLog:
        """The log as it is right after unwrapping: counts, no angle computed yet."""
        assert self.log.driven is not None
        return replace(self.log, driving=replace(self.log.driving), driven=replace(self.log.driven))


def first_order(pair: GearPair, side: int, *, encoders: bool) -> np.ndarray:
    """From parameters to coefficients of (cos φ₁, sin φ₁, cos φ₂, sin φ₂, 1) on a flank, arcsec."""
    gain, alpha = polar_geometry(pair, side)
    cosine, sine = gain * np.cos(alpha), gain * np.sin(alpha)
    matrix = np.zeros((5, 10 if encoders else 6))
    matrix[0, :2] = sine, cosine
    matrix[1, :2] = cosine, -sine
    matrix[2, 2:4] = -sine, cosine
    matrix[3, 2:4] = cosine, sine
    matrix[4, 4 + side] = 1.0
    if encoders:
        ratio = float(pair.ratio)
        matrix[0, 7] = matrix[1, 6] = -ratio
        matrix[2, 9] = matrix[3, 8] = 1.0
    return matrix


def polar_geometry(pair: GearPair, side: int) -> tuple[float, float]:
    """K in arcsec per mm, and α_w with the sign it has beside φ₁ on this flank."""
    alpha = float(pair.working_pressure_angles[side]) * (1 if side == 0 else -1)
    return 1 / float(pair.base_radii[1][side]) / ARCSEC, alpha


def make_problem(orders: Orders, *, encoders: bool) -> Problem:
    """60 rpm forth and back, counts, AR(1) noise of 0.002° with 4.75 ms; the TE exactly linear.

    Free orders have amplitudes of 1.8″, the mesh order 10.8″, all with random phases.
    """
    vttig_jax.enable_x64()
    generator = np.random.default_rng(0)
    pair = _pair()
    terms = plan_terms(pair.ratio, *orders, pair.driving.teeth)
    step = 2 * np.pi / RATE_HZ * (1 + 1e-5 * np.sqrt(2))  # not commensurate with the counts
    forth = step * np.arange(PER_FLANK)
    driving = np.concatenate([forth, forth[::-1]])
    driven = float(pair.ratio) * driving
    error = Noise(0.002, 0.00475).draw(len(driving), RATE_HZ, generator) / ARCSEC
    truth = _truth(encoders)
    for side, half in enumerate(HALVES):
        first, second = driving[half], driven[half]
        weights = first_order(pair, side, encoders=encoders) @ truth
        error[half] += weights[0] * np.cos(first) + weights[1] * np.sin(first) + weights[4]
        error[half] += weights[2] * np.cos(second) + weights[3] * np.sin(second)
        for n1, n2 in (harmonic.term for harmonic in terms.free):
            amplitude = 10.8 if n1 == pair.driving.teeth else 1.8
            shift = generator.uniform(0, 2 * np.pi)
            error[half] += amplitude * np.sin(n1 * first + n2 * second + shift)
    half_count = np.pi / COUNTS
    readings = (driving, driven + error * ARCSEC)
    counts = [quantised(angle + half_count, COUNTS) for angle in readings]
    log = EncoderLog.from_arrays(np.arange(len(driving)) / RATE_HZ, *counts, pair=pair)
    segments = (
        Segment(0, PER_FLANK, "A", step * RATE_HZ),
        Segment(PER_FLANK, 2 * PER_FLANK, "B", -step * RATE_HZ),
    )
    return Problem(pair, log, segments, terms, encoders, truth)


def _truth(encoders: bool) -> np.ndarray:
    rig = paper_eccentricities()
    sizes = [float(rig.driving_mm), float(rig.driven_mm)]
    phases = [float(rig.driving_phase_deg), float(rig.driven_phase_deg)]
    gears = np.array(sizes) * np.exp(1j * np.array(phases) * DEG)
    offsets = [0.0, float(rig.constant_backlash_deg) * DEG / ARCSEC]
    shafts = np.array(ENCODERS_ARCSEC) * np.exp(1j * np.array(ENCODER_PHASES_DEG) * DEG)
    return np.concatenate([gears.view(float), offsets, shafts.view(float) if encoders else []])


def _pair() -> GearPair:
    """The paper's pair; its counters read zero at φ = 0, whatever the noise of the first sample."""
    pair = paper_pair()
    return GearPair(
        pair.driving,
        pair.driven,
        module_mm=float(pair.module_mm),
        pressure_angles_deg=float(pair.pressure_angles_deg[0]),
        centre_distance_mm=float(pair.centre_distance_mm),
        name=pair.name,
        log=LogLayout(zero="reading"),
    )
