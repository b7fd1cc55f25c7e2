"""Backlash of the drawing section by section, beside the apparent one of a fit."""

import math

import numpy as np
import pytest

from tests.geometry.backlash.test_drawn_backlash import make
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.backlash import gap_report, geometric_backlash, section_backlash

pytestmark = pytest.mark.smoke

CROWNED = make(crowning=(10.0, 6.0))


def test_numbers_are_those_of_the_functions():
    report = gap_report(CROWNED, 125.2, 0.9, sections=7)
    expected = float(geometric_backlash(CROWNED, 125.2, 0.9))
    assert report.backlash == pytest.approx(expected, abs=1e-15)
    assert report.backlash_mm == pytest.approx(report.backlash * 80.0)
    assert (report.z_mm[0], report.z_mm[-1]) == pytest.approx((-10.0, 9.1))
    expected = section_backlash(CROWNED, report.z_mm, 125.2, 0.9)
    np.testing.assert_allclose(report.section_backlash, expected, rtol=0, atol=1e-16)
    assert report.section_backlash.min() >= report.backlash - 1e-15
    assert np.ptp(report.section_backlash) > 1e-5


def test_interference_is_told_section_by_section():
    """At s = 0.9 the middle is too thick, the crowned ends are not."""
    report = gap_report(CROWNED, axial_mm=0.9, sections=9)
    assert report.backlash < 0
    assert report.interferes.any() and not report.interferes.all()
    np.testing.assert_array_equal(report.interferes, report.section_backlash < 0)
    rows = str(report).splitlines()[-9:]
    assert [row.endswith("interferes") for row in rows] == report.interferes.tolist()
    assert not gap_report(CROWNED, axial_mm=-0.9).interferes.any()


def test_an_apparent_backlash_stands_beside():
    """What it is more than the drawing, as thickness and as an axial position."""
    pair = make((3.0, 2.0))
    report = gap_report(pair, apparent_deg=0.1)
    assert report.difference is not None
    assert report.difference == pytest.approx(math.radians(0.1) - float(pair.drawing_backlash))
    tapers = math.tan(math.radians(3.0)) + math.tan(math.radians(2.0))
    assert report.opening_mm == pytest.approx(tapers, rel=1e-9)
    position = -report.difference * 80.0 / tapers
    assert f"{position:+.3f} mm of s" in str(report)
    moved = gap_report(pair, axial_mm=position)
    assert moved.backlash == pytest.approx(math.radians(0.1), abs=1e-12)
    assert moved.difference is None
    assert gap_report(pair, axial_mm=0.3, apparent_deg=0.1).difference == report.difference
    logged = gap_report(pair, apparent_deg=0.1, logged_axial_mm=position)
    assert logged.difference == pytest.approx(0.0, abs=1e-12)
    assert f"less that drawn at s = {position:g}" in str(logged)
    assert gap_report(pair).difference is None and "apparent" not in str(gap_report(pair))
    spur = str(gap_report(make((0.0, 0.0)), apparent_deg=0.1))
    assert "of tooth thickness" in spur and "of s" not in spur


def test_one_section_where_the_face_has_none_to_choose():
    report = gap_report(make(widths=(math.nan, math.nan)))
    np.testing.assert_array_equal(report.z_mm, [0.0])


def test_positions_without_a_gap():
    with pytest.raises(ValueError, match="`axial_mm` must leave the faces some overlap"):
        gap_report(make(), axial_mm=25.0)
    with pytest.raises(PairError, match="below a base circle; move the axes apart"):
        gap_report(make(), 115.0)
