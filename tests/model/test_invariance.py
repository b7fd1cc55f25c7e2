"""What is the same log makes the same claims, however it is written down."""

import numpy as np
import pytest

import vttig_jax
from tests.model.rigs import DRIVE, Columns, drive, harmonic_columns, logged
from vttig_jax.logs import EncoderLog
from vttig_jax.pair import Drive, HarmonicOrders

GAP, SIZES = "constant_backlash_deg", ("driving_amplitude_arcsec", "driven_amplitude_arcsec")


def claims(*logs: EncoderLog, pair: Drive = DRIVE) -> dict:
    return dict(vttig_jax.fit(logs, pair, same_zero=True).parameters)


def same(one: dict, other: dict, share: float = 0.02, **factors: float) -> None:
    """Whether all claims agree within a share of their standard errors."""
    assert set(one) == set(other)
    for name, first in one.items():
        factor, twin = factors.get(name, 1.0), other[name]
        assert (twin.determined, twin.significant) == (first.determined, first.significant), name
        if first.value is not None:
            allowed = share * factor * first.std
            assert twin.value == pytest.approx(factor * first.value, abs=allowed), name
            assert twin.std == pytest.approx(factor * first.std, rel=share), name


@pytest.fixture(scope="module")
def given() -> Columns:
    return harmonic_columns()


@pytest.fixture(scope="module")
def claimed(given) -> dict:
    return claims(logged(given))


UNITS = {"deg": np.pi / 180, "rev": 2 * np.pi, "arcsec": np.pi / 648000, "urad": 1e-6}


@pytest.mark.parametrize("unit", UNITS)
def test_units_of_the_angles(given, claimed, unit):
    time, *angles = given
    driving, driven = (angle / UNITS[unit] for angle in angles)
    same(claimed, claims(logged((time, driving, driven), unit=unit)))


@pytest.mark.parametrize(("later_s", "periods"), [(1e6, 0), (0.0, 5)])
def test_zeros_of_time_and_angles(given, claimed, later_s, periods):
    """A later clock, or both shafts whole turns on: 80 and 45."""
    time, driving, driven = given
    on = 2 * np.pi * periods
    moved = time + later_s, driving + 16 * on, driven + 9 * on
    same(claimed, claims(logged(moved)), share=0.05)


def test_time_scaled(given, claimed):
    """Eight times slower: the delay is eight times as long, and no other claim moves."""
    same(claimed, claims(logged((8 * given[0], *given[1:]))), delay_s=8.0)


def test_columns_swapped_with_the_ratio(given, claimed):
    """TE is −1/i of that before, and the flanks change places; the delay changes its sign."""
    inverse, ratio = drive("16/9", HarmonicOrders((1, 2), (1, 2, 3), 0)), 9 / 16
    swapped = claims(logged((given[0], given[2], given[1]), inverse), pair=inverse)
    for name, twin in ((GAP, GAP), SIZES, SIZES[::-1], ("delay_s", "delay_s")):
        one, other = claimed[name], swapped[twin]
        factor = 1.0 if name == "delay_s" else 1 / ratio
        allowed = factor * one.std
        assert abs(other.value) == pytest.approx(factor * abs(one.value), abs=allowed), name
        assert other.std == pytest.approx(allowed, rel=0.3), name
    assert swapped["delay_s"].value < 0 < claimed["delay_s"].value


def test_logs_in_another_order(claimed):
    logs = [logged(harmonic_columns(seed=seed)) for seed in (1, 2)]
    both = claims(*logs)
    same(both, claims(*logs[::-1]))
    for name in (GAP, SIZES[0]):
        assert both[name].std < 0.85 * claimed[name].std


def test_rows_in_two_halves(given, claimed):
    """Every other row in a log of its own: the claims of the whole log."""
    time, driving, driven = given
    halves = [logged((time[k::2], driving[k::2], driven[k::2])) for k in (0, 1)]
    both, half = claims(*halves), claims(halves[0])
    for name in (GAP, *SIZES, "delay_s"):
        one, other = claimed[name], both[name]
        assert abs(other.value - one.value) < 0.6 * one.std, name
        assert other.std == pytest.approx(one.std, rel=0.2), name
        assert half[name].std > 1.2 * one.std, name


def test_rows_repeated(given, claimed):
    """A recorder that reads both channels twice between their changes knows no more."""
    time, driving, driven = (np.repeat(column, 2) for column in given)
    time[1::2] += 0.5 * (time[2] - time[0])
    repeated = claims(logged((time, driving, driven)))
    for name in (GAP, *SIZES, "delay_s"):
        one, other = claimed[name], repeated[name]
        assert other.std > 0.9 * one.std, name
        assert abs(other.value - one.value) < 3 * other.std, name


def test_another_log_makes_other_claims(claimed):
    with pytest.raises(AssertionError):
        same(claimed, claims(logged(harmonic_columns(gap_deg=0.101))))
