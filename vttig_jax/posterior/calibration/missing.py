"""How large an order has to be to stand out by so many standard errors."""

import numpy as np

from ..planned_noise import PlannedNoise
from .layout import columns_of, planned
from .motion import driving_angles, row_size
from .rigs import MISSING
from .scenarios import Scenario


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
