"""Whitened coordinates of the second sampler; they need no package beside the project's own."""

from unittest.mock import Mock

import jax.numpy as jnp
import numpy as np

from vttig_jax.posterior.density.density import NOISE_STD, FitTarget
from vttig_jax.posterior.density.evaluation import Density
from vttig_jax.posterior.nuts import whitened_of


def test_standard_normal_coordinates_have_the_covariance_of_the_fit():
    """To first order x = centre + J y, by central differences, and J Jᵀ is the covariance."""
    centre = np.array([0.02, -0.01, -11.0, 0.8, -0.5])
    spread = np.array([1e-3, 2e-3, 0.02, 0.01, 0.02])[:, None]
    rotated = spread * np.linalg.cholesky(0.6 * np.eye(5) + 0.4)
    target = Mock(
        spec=FitTarget,
        names=("driving_x", "driving_y", NOISE_STD, "partial_1", "partial_2"),
        centre=centre,
        covariance=rotated @ rotated.T,
        density=Mock(spec=Density),
    )
    whitened = whitened_of(target)

    def point(y: np.ndarray) -> np.ndarray:
        return np.asarray(whitened.point(jnp.asarray(y)))

    step = 1e-4
    slopes = [(point(move) - point(-move)) / (2 * step) for move in step * np.eye(5)]
    slopes = np.stack(slopes, axis=1) / spread
    np.testing.assert_allclose(point(np.zeros(5)), centre, rtol=1e-12)
    np.testing.assert_allclose(slopes @ slopes.T, 0.6 * np.eye(5) + 0.4, rtol=0, atol=1e-6)
