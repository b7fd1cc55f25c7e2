"""What the report by section says, against the classical limits and the surface itself."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.geometry.surface_teeth import any_tooth, crowned, tooth
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.checks import check_tooth, section_report
from vttig_jax.geometry.form import undercut_depth
from vttig_jax.geometry.surface import fillet_span, flank_roll, tooth_surface
from vttig_jax.geometry.tooth import SIDES, Taper

PAPER = tooth(
    pressure_angles_deg=np.array([20.0, 20.0]),
    recession=(Taper(math.tan(math.radians(3.0))),) * 2,
    fillet_radius_mm=0.5 / (1 - math.sin(math.radians(20.0))),
)
NARROW = np.array([-10.0, -2.0, 10.0])


def spur(teeth, alpha_deg, shift_modules):
    """Module 2 with the usual arc, so that the straight flank reaches the addendum deep."""
    arc = 0.5 / (1 - math.sin(math.radians(alpha_deg)))
    return tooth(
        teeth,
        pressure_angles_deg=np.array([alpha_deg, alpha_deg]),
        recession=(Taper(0.0), Taper(0.0)),
        profile_shift_mm=2.0 * shift_modules,
        fillet_radius_mm=arc,
    )


@given(st.floats(14.5, 30.0), st.floats(-0.5, 0.6))
def test_undercut_begins_at_the_classical_number_of_teeth(alpha_deg, shift):
    """z = 2 (h_a − x)/sin² α."""
    limit = 2 * (1.0 - shift) / math.sin(math.radians(alpha_deg)) ** 2
    below, above = math.floor(limit), math.ceil(limit)
    assume(below >= 4 and min(limit - below, above - limit) > 1e-6)
    depth = undercut_depth(spur(below, alpha_deg, shift), "left")
    lost = 2.0 * (1.0 - shift) - below * math.sin(math.radians(alpha_deg)) ** 2
    assert depth == pytest.approx(lost, abs=1e-9)
    assert section_report(spur(below, alpha_deg, shift), [0.0]).undercut.all()
    assert not section_report(spur(above, alpha_deg, shift), [0.0]).undercut.any()


@given(any_tooth())
def test_flanks_meet_at_the_end_radius(gear):
    """Both flanks taken to that radius are at the same point; the tip is thin just where it is."""
    z = np.array([-8.0, 6.0])
    found = section_report(gear, z)
    assume(np.all(np.isfinite(found.end_radius_mm)))
    with jax.disable_jit():
        left, right = (
            tooth_surface(gear, flank_roll(gear, found.end_radius_mm, side), z, side=side)
            for side in SIDES
        )
    np.testing.assert_allclose(left, right, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.pointed, found.end_radius_mm <= gear.tip_radius)


def test_a_pointed_tooth_is_told_and_not_clipped():
    gear = replace(PAPER, profile_shift_mm=np.float64(2.5))
    found = section_report(gear, NARROW)
    np.testing.assert_array_equal(found.pointed, [False, False, True])
    assert found.tip_thickness_mm[2] < 0 < found.end_radius_mm[2] < gear.tip_radius
    assert f"pointed at radius {found.end_radius_mm[2]:.3f} mm" in found.remarks(2)


def test_flanks_that_never_stood_have_no_end():
    gear = tooth(recession=(Taper(0.5), Taper(0.5)))
    found = section_report(gear, [10.0])
    assert found.gone.all() and np.isnan(found.end_radius_mm).all()
    assert "no tooth at the reference circle" in found.remarks(0)


@given(any_tooth(), st.floats(-10.0, 10.0))
def test_root_land_is_the_arc_between_the_fillets(gear, z):
    """From the lowest point of a left fillet to that of the right one of the tooth before."""
    with jax.disable_jit():
        left, right = (
            np.asarray(tooth_surface(gear, fillet_span(gear, side)[0], z, side=side, part="fillet"))
            for side in SIDES
        )
    ends = [math.atan2(x, y) for x, y, _ in (left, right)]
    land = float(gear.root_radius) * (2 * math.pi / gear.teeth - (ends[1] - ends[0]))
    found = section_report(gear, [z])
    np.testing.assert_allclose(found.root_land_mm, land, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(found.fillet_overlap, [land < 0])


def test_largest_fillet_radius_fills_the_tip_of_the_cutter():
    gear = tooth()
    found = section_report(gear, NARROW)
    for z, radius in zip(NARROW, found.largest_fillet_radius_mm, strict=True):
        full = section_report(replace(gear, fillet_radius_mm=radius), [z])
        assert full.root_land_mm[0] == pytest.approx(0.0, abs=1e-12)


def test_report_reads_well():
    text = str(section_report(PAPER, [-10.0, 0.0, 10.0]))
    assert text.splitlines() == [
        "1 of 3 sections is not sound",
        " z [mm]  thickness [mm]  at the tip [mm]  root land [mm]",
        "-10.000          4.1897           2.6323         -0.7467  fillets overlap, radius 0.195 mm"
        " fits",
        "  0.000          3.1416           1.5376          0.2433  sound",
        " 10.000          2.0934           0.4428          1.2332  sound",
    ]
    whole = str(section_report(PAPER)).splitlines()
    assert whole[0] == "16 of 41 sections are not sound"
    assert (
        len(whole) == 13 and whole[2].split()[0] == "-10.000" and whole[-1].split()[0] == "10.000"
    )
    np.testing.assert_array_equal(section_report(PAPER, NARROW).sound, [False, True, True])
    unlike = tooth(15, pressure_angles_deg=np.array([20.0, 25.0]), recession=(Taper(0.0),) * 2)
    assert section_report(unlike, [0.0]).remarks(0).startswith("undercut by")
    assert "left flank" in section_report(unlike, [0.0]).remarks(0)
    both = section_report(tooth(8, recession=(Taper(0.0),) * 2), [0.0])
    assert "both flanks" in both.remarks(0)
    assert str(section_report(spur(30, 20.0, 0.0))).startswith("none of 41 sections are not sound")


def test_sections_without_a_face_width():
    gear = tooth(face_width_mm=math.nan)
    with pytest.raises(ValueError, match="`z` must be given for a gear without a face width"):
        section_report(gear)
    assert len(section_report(gear, [1.0, 2.0]).z_mm) == 2
    with pytest.raises(ValueError, match="`z` must be finite heights in mm"):
        section_report(gear, [math.nan])


def test_a_recession_that_is_not_finite_is_refused():
    gear = tooth(recession=(Taper(0.0), crowned(0.0, math.nan)))
    with pytest.raises(
        PairError, match="recession of the right flank: δ is not finite at z = -3 mm"
    ):
        section_report(gear, [-3.0])


# Gears that have no tooth surface are refused with one sentence and a cure.


def test_thin_end_names_the_section():
    steep = Taper(math.tan(math.radians(12.0)))
    with pytest.raises(PairError) as caught:
        check_tooth(tooth(recession=(steep, steep)))
    assert str(caught.value) == (
        "thickness: the tooth is -1.110 mm thick on the reference circle at z = 10 mm; make the"
        " face narrower (the tooth vanishes at z = 7.5 mm), the helix angles smaller or the"
        " profile shift larger."
    )
    check_tooth(tooth(recession=(steep, steep)), [-10.0, 7.0])


def test_recessions_that_are_none():
    for recession in (
        Taper(math.nan),
        lambda z: 1 / z,
        lambda z: 0.1,
        lambda z: np.sin(z),
        lambda z: z if z[0] > 0 else -z,
    ):
        with np.errstate(divide="ignore"), pytest.raises(PairError) as caught:
            check_tooth(tooth(recession=(recession, Taper(0.0))))
        assert caught.value.where == "recession of the left flank"
        assert caught.value.exit_code == 3


def test_numbers_that_are_no_gear():
    for changes, where in (
        ({"module_mm": 0.0}, "module_mm"),
        ({"module_mm": math.nan}, "module_mm"),
        ({"pressure_angles_deg": np.array([20.0, 95.0])}, "pressure_angles_deg"),
        ({"addendum_mm": -1.0}, "addendum_mm"),
        ({"dedendum_mm": math.inf}, "dedendum_mm"),
        ({"fillet_radius_mm": -0.1}, "fillet_radius_mm"),
        ({"fillet_radius_mm": math.nan}, "fillet_radius_mm"),
        ({"dedendum_mm": 46.0}, "root radius"),
        ({"profile_shift_mm": -5.0}, "tip radius"),
    ):
        changes = {key: np.asarray(value, float) for key, value in changes.items()}
        with pytest.raises(PairError) as caught:
            check_tooth(replace(tooth(), **changes))
        assert caught.value.where == where
