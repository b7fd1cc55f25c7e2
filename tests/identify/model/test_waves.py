"""Waves by products of lower orders are those of cosine and sine."""

from fractions import Fraction

import numpy as np
import pytest

from vttig_jax.identify.model.waves import Waves

pytestmark = pytest.mark.smoke


@pytest.mark.parametrize("order", [0, 1, -1, 2, 3, 8, -45, 64, Fraction(6, 2), Fraction(-7, 3)])
def test_any_order_of_any_angle(order):
    angle = np.random.default_rng(0).uniform(-300.0, 300.0, 200)
    exact = np.exp(1j * float(order) * angle)
    np.testing.assert_allclose(Waves(angle).of(order), exact, atol=2e-12)


def test_orders_share_what_is_known():
    waves = Waves(np.linspace(0.0, 6.0, 5))
    for order in (5, -5, 2, 5):
        np.testing.assert_allclose(waves.of(order), np.exp(1j * order * waves.angle), atol=1e-14)
