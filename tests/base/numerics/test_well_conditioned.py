"""Inverses and bases of matrices that may be singular."""

import numpy as np
import pytest

from vttig_jax.base.numerics.well_conditioned import (
    least_squares,
    orthonormal_basis,
    pseudo_inverse,
)

pytestmark = pytest.mark.smoke


def test_inverse_and_basis_are_those_of_the_singular_values():
    for dependent in (0, 2):
        for spread in (1.0, 1e3):
            generator = np.random.default_rng(0)
            columns = generator.normal(size=(60, 8)) * np.geomspace(1.0, spread, 8)
            columns[:, : 2 * dependent : 2] = columns[:, 1 : 2 * dependent : 2]
            matrix = columns.T @ columns
            wanted = np.linalg.pinv(matrix, rcond=1e-12, hermitian=True)
            np.testing.assert_allclose(pseudo_inverse(matrix, 1e-12), wanted, atol=1e-9)
            basis, vectors = orthonormal_basis(columns, 1e-6), np.linalg.svd(columns)[0]
            assert basis.shape == (60, 8 - dependent)
            np.testing.assert_allclose(basis.T @ basis, np.eye(8 - dependent), atol=1e-14)
            kept = vectors[:, : 8 - dependent]
            np.testing.assert_allclose(basis @ basis.T, kept @ kept.T, atol=1e-9)


def test_column_of_zeros_has_no_inverse_and_no_direction():
    assert pseudo_inverse(np.diag([4.0, 0.0]), 1e-12).tolist() == [[0.25, 0.0], [0.0, 0.0]]
    assert orthonormal_basis(np.eye(5)[:, :2] * [1.0, 0.0], 1e-6).shape == (5, 1)


@pytest.mark.parametrize("near", [1.0, 1e-3, 0.0])
def test_coefficients_are_those_of_the_singular_values(near: float):
    """Columns of different lengths, two of which are more or less alike."""
    generator = np.random.default_rng(0)
    columns = generator.normal(size=(300, 5)) * [1.0, 1e6, 1e-3, 1.0, 1.0]
    columns[:, 4] = columns[:, 3] + near * columns[:, 4]
    values = generator.normal(size=300)
    size = np.linalg.norm(columns, axis=0)
    wanted = np.linalg.lstsq(columns / size, values, rcond=1e-14)[0] / size
    np.testing.assert_allclose(least_squares(columns, values, 1e-14), wanted, rtol=1e-9)
