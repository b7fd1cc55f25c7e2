"""The line round a whole tooth: its pieces, their order, and that teeth join to a gear."""

from functools import cache

import numpy as np
import pytest

from tests.geometry.surface_teeth import between, crowned, tooth, wave
from vttig_jax.geometry.tooth.rack_cutter import SIDES
from vttig_jax.geometry.tooth.roll_limits import fillet_span, flank_span
from vttig_jax.geometry.tooth.section_outline import ToothSection, tooth_section
from vttig_jax.geometry.tooth.surface import PARTS, tooth_surface

GEAR = tooth(20, recession=(crowned(0.02, 0.03), wave), profile_shift_mm=0.3)
HEIGHTS = np.array([-1.0, 0.0, 10.0])


@cache
def section() -> ToothSection:
    return tooth_section(GEAR, HEIGHTS, intervals=40)


def turned(points, angle):
    x, y = points[..., 0], points[..., 1]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([x * cosine - y * sine, x * sine + y * cosine, points[..., 2]], axis=-1)


def area(points):
    """Twice-signed area of closed polygons by Gauss, mm²."""
    x, y = points[..., 0], points[..., 1]
    return np.sum(x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1), axis=-1) / 2


def test_pieces_are_in_order_and_share_their_ends():
    assert section().points.shape == (3, 8 * 40 + 1, 3)
    assert [side for side, _ in section().pieces] == ["right"] * 4 + ["left"] * 4
    assert [part for _, part in section().pieces] == [*PARTS, *reversed(PARTS)]
    for one, two in zip(section().pieces, section().pieces[1:], strict=False):
        np.testing.assert_array_equal(section().piece(*one)[:, -1], section().piece(*two)[:, 0])
    assert len(section().labels) == 320
    assert section().labels[0] == "right root" and section().labels[319] == "left root"
    assert section().labels[45] == "right fillet"


def test_pieces_are_those_of_the_surface():
    for side in SIDES:
        flank = section().piece(side, "flank")[1]
        rolls = between(flank_span(GEAR, side), 41)
        wanted = np.asarray(tooth_surface(GEAR, rolls, 0.0, side=side))
        np.testing.assert_allclose(
            flank if side == "right" else flank[::-1], wanted, rtol=0, atol=1e-13
        )
        ends = section().piece(side, "fillet")[1, [0, -1]]
        wanted = tooth_surface(GEAR, fillet_span(GEAR, side), 0.0, side=side, part="fillet")
        np.testing.assert_allclose(
            ends if side == "right" else ends[::-1], wanted, rtol=0, atol=1e-13
        )


def test_teeth_join_to_a_closed_gear():
    """Counter-clockwise, with an area between that of the root and that of the tip circle."""
    pitch = 2 * np.pi / 20
    np.testing.assert_allclose(
        turned(section().points[:, 0], pitch), section().points[:, -1], rtol=0, atol=1e-13
    )
    whole = np.concatenate([turned(section().points[:, :-1], k * pitch) for k in range(20)], axis=1)
    inner, outer = (np.pi * float(r) ** 2 for r in (GEAR.root_radius, GEAR.tip_radius))
    assert np.all((inner < area(whole)) & (area(whole) < outer))
    assert np.all(area(whole[:, ::-1]) < 0)
    assert np.all(np.diff(area(whole)) < 0)  # the tooth thins upwards


def test_sound_teeth_do_not_fold():
    """Every step leads on: no piece runs back over the one before."""
    steps = np.diff(np.asarray(section().points), axis=1)[..., :2]
    lengths = np.linalg.norm(steps, axis=-1)
    assert lengths.min() > 1e-4
    turns = np.sum(steps[:, 1:] * steps[:, :-1], axis=-1) / (lengths[:, 1:] * lengths[:, :-1])
    corners = turns < 0.8
    assert corners.sum() == 2 * len(HEIGHTS)  # the two edges of each tip


def test_a_pointed_tooth_runs_back_over_its_tip():
    """Nothing is clipped: that is how it shows."""
    thin = tooth(20, profile_shift_mm=1.2)
    x = np.asarray(tooth_section(thin, np.array([10.0]), intervals=4).piece("right", "tip"))[
        0, :, 0
    ]
    assert x[0] < x[-1]
    sound = np.asarray(section().piece("right", "tip"))[0, :, 0]
    assert sound[0] > sound[-1]


def test_one_section_and_wrong_numbers():
    assert tooth_section(GEAR, 0.0, intervals=1).points.shape == (9, 3)
    np.testing.assert_allclose(
        tooth_section(GEAR, 0.0, intervals=40).points, section().points[1], rtol=0, atol=1e-13
    )
    with pytest.raises(ValueError, match="`intervals` must be 1 or more, but is 0"):
        tooth_section(GEAR, 0.0, intervals=0)


def test_fillet_whose_arc_is_centred_on_the_pitch_line():
    """Roll angles do not tell its points apart, directions do."""
    gear = tooth(profile_shift_mm=1.9)
    fillet = np.asarray(tooth_section(gear, 0.0).piece("right", "fillet"))
    assert np.ptp(fillet_span(gear, "right")) == pytest.approx(0.0, abs=1e-15)
    assert np.all(np.diff(np.hypot(fillet[:, 0], fillet[:, 1])) > 0)
