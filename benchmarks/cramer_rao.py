"""The least standard errors any unbiased method can have on a log of the synthetic rig.

Computed from single samples and the true noise: no block means, no estimated autoregression, no
part of `identify`. The noise is a first-order autoregression plus the white error of both counters,
which together are an ARMA(1, 1) with the whitening filter (1 − aL)/(1 + bL).
"""

import numpy as np
from scipy.signal import lfilter

from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.logs.motion.segments import find_segments
from vttig_jax.pair.gear_pair import GearPair
from vttig_jax.rig.synthetic import SyntheticRig

ORDERS = tuple(range(2, 9))
_TRANSIENT = 50
"""Samples after which the filter has forgotten that it started between zeros."""


def cramer_rao(rig: SyntheticRig, grid: np.ndarray) -> dict[str, float]:
    """Least standard errors of the parameters, and of the backlash map as an rms over `grid`.

    Free are both eccentricities, both encoder errors, an offset of each flank, and on each flank
    orders 2 to 8 of both shafts and the tooth mesh, without the duplicates of the tooth counts.
    """
    log = rig.log()
    width = 10 + 2 * 2 * len(_terms(rig))
    information = np.zeros((width, width))
    autoregression, moving, innovation = _arma(rig)
    for segment in find_segments(log).segments:
        part = slice(segment.start, segment.stop)
        rows = _design(rig, log.driving_angle[part], log.driven_angle[part], segment.flank)
        white = np.asarray(lfilter([1.0, -autoregression], [1.0, moving], rows, axis=0))
        white = white[_TRANSIENT:] / innovation
        information += white.T @ white
    size = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    driven = float(rig.pair.ratio) * grid
    difference = _design(rig, grid, driven, "B") - _design(rig, grid, driven, "A")
    spread = np.einsum("ni,ij,nj->n", difference, covariance, difference)
    return _named(rig, covariance) | {"map_rms_deg": float(np.sqrt(spread.mean())) * ARCSEC / DEG}


def _terms(rig: SyntheticRig) -> list[tuple[int, int]]:
    """Orders above the first, each frequency once."""
    ratio, kept = rig.pair.ratio, {}
    wanted = [(1, 0), (0, 1), *((k, 0) for k in ORDERS), *((0, k) for k in ORDERS)]
    for n1, n2 in [*wanted, (rig.pair.driving.teeth, 0)]:
        kept.setdefault(n1 + n2 * ratio, (n1, n2))
    return list(kept.values())[2:]


def _design(rig: SyntheticRig, driving: np.ndarray, driven: np.ndarray, flank: str) -> np.ndarray:
    """Derivative of TE on one flank by every parameter, arcsec per mm or arcsec."""
    side, terms = "AB".index(flank), _terms(rig)
    four = [np.cos(driving), np.sin(driving), np.cos(driven), np.sin(driven)]
    columns = np.stack([*four, np.ones_like(driving)], axis=1)
    matrix = np.zeros((len(driving), 10 + 4 * len(terms)))
    matrix[:, :10] = columns @ _first_order(rig.pair, side)
    for place, (n1, n2) in enumerate(terms):
        column = 10 + 2 * (side * len(terms) + place)
        phase = n1 * driving + n2 * driven
        matrix[:, column], matrix[:, column + 1] = np.cos(phase), np.sin(phase)
    return matrix


def _first_order(pair: GearPair, side: int) -> np.ndarray:
    """From parameters to coefficients of (cos φ₁, sin φ₁, cos φ₂, sin φ₂, 1) on a flank, arcsec.

    The parameters are those of (19) and (20): x and y of both eccentricities in mm, the offsets of
    both flanks in arcsec, x and y of both encoder errors in arcsec.
    """
    gain = 1 / float(pair.base_radii[1][side]) / ARCSEC
    alpha = float(pair.working_pressure_angles[side]) * (1 if side == 0 else -1)
    cosine, sine = gain * np.cos(alpha), gain * np.sin(alpha)
    matrix = np.zeros((5, 10))
    matrix[0, :2] = sine, cosine
    matrix[1, :2] = cosine, -sine
    matrix[2, 2:4] = -sine, cosine
    matrix[3, 2:4] = cosine, sine
    matrix[4, 4 + side] = 1.0
    matrix[0, 7] = matrix[1, 6] = -float(pair.ratio)
    matrix[2, 9] = matrix[3, 8] = 1.0
    return matrix


def _arma(rig: SyntheticRig) -> tuple[float, float, float]:
    """a, b and the innovation in arcsec of the noise of single samples."""
    a = np.exp(-1 / (rig.rate_hz * rig.noise.correlation_s))
    counts = [gear.encoder.counts_per_rev for gear in (rig.pair.driving, rig.pair.driven)]
    steps = [REV / count / ARCSEC for count in counts if count is not None]
    white = (steps[1] ** 2 + (float(rig.pair.ratio) * steps[0]) ** 2) / 12
    level = (rig.noise.std_deg * DEG / ARCSEC) ** 2 * (1 - a**2) + white * (1 + a**2)
    correlation = -a * white / level
    b = (1 - np.sqrt(1 - 4 * correlation**2)) / (2 * correlation)
    return float(a), float(b), float(np.sqrt(level / (1 + b**2)))


def _named(rig: SyntheticRig, covariance: np.ndarray) -> dict[str, float]:
    """Standard errors of what people quote, from those of the Cartesian parameters."""
    gears = rig.eccentricities
    encoders = (rig.driving_encoder, rig.driven_encoder)
    vectors = {
        "driving_eccentricity_mm": (0, gears.driving_mm, gears.driving_phase_deg),
        "driven_eccentricity_mm": (2, gears.driven_mm, gears.driven_phase_deg),
        "driving_encoder_arcsec": (6, encoders[0].amplitude_arcsec, encoders[0].phase_deg),
        "driven_encoder_arcsec": (8, encoders[1].amplitude_arcsec, encoders[1].phase_deg),
    }
    least = {}
    for name, (place, size, phase_deg) in vectors.items():
        block = covariance[place : place + 2, place : place + 2]
        angle = float(phase_deg) * DEG
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        least[name] = float(np.sqrt(along @ block @ along))
        phase = name.replace("_eccentricity_mm", "_phase").replace("_arcsec", "_phase") + "_deg"
        least[phase] = float(np.sqrt(across @ block @ across)) / float(size) / DEG
    gap = np.zeros(len(covariance))
    gap[4:6] = -1.0, 1.0
    least["constant_backlash_deg"] = float(np.sqrt(gap @ covariance @ gap)) * ARCSEC / DEG
    return least
