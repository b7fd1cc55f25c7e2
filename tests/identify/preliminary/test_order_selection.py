"""Higher orders enter on few turns only if the noise does not explain them."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.identify.compress.regressors import Drift
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.model.identifiability import find_identifiability
from vttig_jax.identify.noise.freedom import freedom
from vttig_jax.identify.preliminary.linear_fit import Input, Model, linear_fit
from vttig_jax.identify.preliminary.order_selection import entering_orders
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments
from vttig_jax.pair.gear_pair import Drive, Gear, GearPair
from vttig_jax.pair.schema import HarmonicOrders

ORDERS = (1, 2, 3, 4, 5)
PAIR = drive("3/7", orders=ORDERS)
MOTION = there_and_back([60], 4)
GEARS = GearPair(
    Gear(60, 3.0, 3.0, 20.0),
    Gear(35, 3.0, 3.0, 20.0),
    module_mm=2.0,
    pressure_angles_deg=20.0,
    centre_distance_mm=95.12,
    fit=HarmonicOrders(ORDERS, ORDERS, 0),
)


def log_of(
    seed: int,
    *,
    order_arcsec: float = 0.0,
    noise_arcsec: float = 30.0,
    white_arcsec: float | None = None,
    pair: Drive | GearPair = PAIR,
) -> EncoderLog:
    """Four turns each way; the noise remembers a quarter of a second."""
    generator = np.random.default_rng(seed)
    count = 20_000
    rho = np.exp(-0.001 / 0.25)
    steps = generator.normal(size=count) * np.sqrt(1 - rho**2)
    slow = lfilter([1.0], [1.0, -rho], steps)

    def error(angle, _):
        own = noise_arcsec * np.asarray(slow)[: 10 * len(angle) : 10] if len(angle) < 2000 else 0
        return own + 60 * np.sin(angle + 0.4) + order_arcsec * np.sin(3 * angle + seed)

    return drive_log(
        pair,
        MOTION,
        gap=level(300.0),
        error=error,
        noise_arcsec=0.02 * noise_arcsec if white_arcsec is None else white_arcsec,
        seed=seed,
    )


def looked(log: EncoderLog, pair: Drive | GearPair = PAIR):
    found = assigned_segments(log)
    scope = find_identifiability([log], [found.segments], pair, pair.fit, None, remembers=True)
    model = Model(pair, scope.terms, ("ratio",) if pair is PAIR else (), Drift(0))
    return scope, linear_fit([Input(log, found, scope.segments[0])], model).summary


def entering(log: EncoderLog, pair: Drive | GearPair = PAIR) -> HarmonicOrders | None:
    scope, summary = looked(log, pair)
    return entering_orders(summary, scope.terms.free, pair.fit, any_noise=pair is PAIR)


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_remembers_is_no_order(seed):
    assert entering(log_of(seed)) == HarmonicOrders((1,), (1,), 0)


@pytest.mark.parametrize("seed", range(3))
def test_an_order_above_the_noise_enters(seed):
    assert entering(log_of(seed, order_arcsec=80.0)) == HarmonicOrders((1, 3), (1,), 0)


def test_every_order_stays_without_noise():
    log = log_of(0, order_arcsec=80.0, noise_arcsec=0.0)
    found = entering(log)
    assert found is not None
    assert found.driving_orders == ORDERS


def test_what_does_not_enter_is_told():
    result = fit(log_of(1, order_arcsec=80.0), PAIR)
    assert {(o.shaft, o.order) for o in result.orders} == {
        ("driving", 1),
        ("driving", 3),
        ("driven", 1),
    }
    (note,) = [note for note in result.notes if "not larger than noise" in note]
    assert note.startswith("driving orders 2, 4 and 5 and driven orders 3 and 4 are not")


def test_a_gear_pair_has_few_turns_only_where_its_noise_remembers():
    slow = log_of(2, pair=GEARS, noise_arcsec=9.0)
    assert entering(slow, GEARS) == HarmonicOrders((1,), (1,), 0)
    result = fit(slow, GEARS)
    assert {o.order for o in result.orders} == {1}
    fast = log_of(2, pair=GEARS, order_arcsec=10.0, noise_arcsec=0.0, white_arcsec=1.0)
    assert entering(fast, GEARS) is None
    assert {o.order for o in fit(fast, GEARS).orders} == set(ORDERS)


def test_white_noise_has_all_degrees_of_freedom():
    _, summary = looked(log_of(0, noise_arcsec=10.0))
    coefficients = len(summary.flanks) * (summary.columns.width - 1)
    unit = [np.eye(summary.columns.width - 1)[:, :1] for _ in summary.flanks]
    found = freedom(summary, np.zeros(0), unit)[0]
    assert found == pytest.approx(summary.counted_rows - coefficients, rel=1e-3)
    assert freedom(summary, np.array([0.9]), unit)[0] < found
