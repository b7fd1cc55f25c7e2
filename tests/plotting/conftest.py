"""Fits with chosen numbers: tests of pictures need no identification."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pytest

from tests.identify.quick import quick_rig
from vttig_jax.base import ARCSEC, DEG
from vttig_jax.identify import Checks, Fit
from vttig_jax.identify.identification import fit as identified
from vttig_jax.identify.orders import Order
from vttig_jax.identify.records import Noise
from vttig_jax.kinematics import OrderModel, TECurve
from vttig_jax.pair import Drive, HarmonicOrders
from vttig_jax.pair.gear_pair import Flank

ORDERS = (
    Order("driving", 1, "A", 72.0, 0.2, 10.0),
    Order("driving", 1, "B", 73.0, 0.2, 20.0),
    Order("driving", 3, "A", 0.5, 0.4, 30.0, significant=False),
    Order("driving", 3, "B", 2.0, 0.4, 40.0),
    Order("driven", 1, "A", 90.0, 0.2, 50.0),
    Order("driven", 1, "B", 92.0, 0.2, 60.0),
    Order("mesh", 1, "A", 11.0, 0.1, 70.0),
    Order("mesh", 1, "B", 10.0, 0.1, 80.0),
)


@pytest.fixture(scope="session")
def make_curve() -> Callable[..., TECurve]:
    """Function that returns a TE curve of one flank, a sine of 70″.

    The curve of flank B runs backwards and is 0.04° higher.
    """
    return made_curve


def made_curve(
    flank: Flank, first_deg: float = 30.0, last_deg: float = 1800.0, points: int = 400
) -> TECurve:
    angle = np.linspace(first_deg, last_deg, points) * DEG
    if flank == "B":
        angle = angle[::-1].copy()
    error = 70 * ARCSEC * np.sin(angle) + (0.0 if flank == "A" else 0.04 * DEG)
    return TECurve(flank, angle, error, np.linspace(0, 5, points))


@pytest.fixture(scope="session")
def make_fit(paper_pair) -> Callable[..., Fit]:
    """Function that returns a `Fit` with the given curves, orders, source and pair."""
    rig = quick_rig(0)
    fitted = identified(rig.log(0), rig.pair, orders=HarmonicOrders((1,), (1,), 0))

    def make(
        curves=None,
        orders: tuple[Order, ...] = ORDERS,
        source: str = "somewhere/log.csv",
        pair=paper_pair,
        residual_arcsec: float = 3.0,
        offset_deg: tuple[float, float] = (0.0, 0.04),
    ) -> Fit:
        curves = (made_curve("A"), made_curve("B")) if curves is None else curves
        generator = np.random.default_rng(0)
        amplitude = 70 * ARCSEC
        return replace(
            fitted,
            pair=pair,
            source=source,
            flanks=tuple(sorted({curve.flank for curve in curves})),
            orders=orders,
            model=OrderModel(
                jnp.asarray(float(pair.ratio)),
                ((1, 0), (0, 1)),
                jnp.asarray(offset_deg) * DEG,
                jnp.zeros((2, 2)),
                jnp.array([[amplitude, 0.0], [amplitude, amplitude / 3]]),
            ),
            noise=Noise("AR(1)", (0.0,), 0.005, 6e-4, 6e-4, 0.0025, 0.0),
            residual_rms_deg=4.5 / 3600,
            curves=curves,
            residuals=tuple(
                residual_arcsec * ARCSEC * generator.standard_normal(len(curve)) for curve in curves
            ),
            checks=Checks(),
            findings=(),
        )

    return make


@pytest.fixture(scope="session")
def worm_fit(make_fit) -> Fit:
    """Fit of a drive that turned in one direction: the model of flank B contains NaN."""
    return make_fit(
        curves=(made_curve("A"),),
        orders=(Order("driving", 1, "A", 3.8, 0.05, 68.0),),
        pair=Drive(Fraction(1, 225), name="worm"),
        offset_deg=(0.0, np.nan),
    )
