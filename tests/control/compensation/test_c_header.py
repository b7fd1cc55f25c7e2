"""The C header compiled and run, beside the Python of the same harmonics and the map itself."""

import dataclasses
import math
import re
import subprocess
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control import headers
from tests.control.compensation.test_compensation import (
    ALLOWED,
    ANGLES,
    ORIGIN,
    drive_map,
    readings,
    wrapped,
)
from tests.control.headers import called, compiled, needs_cc
from tests.oracles.compensated import gap_at, shift_at
from vttig_jax.base.errors import UsageError
from vttig_jax.base.units import DEG
from vttig_jax.control.compensation.c_header import (
    HeaderOrigin,
    c_header,
    check_identifier,
    identifier_of,
)
from vttig_jax.control.compensation.compensation import Compensation, compensation_of
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig.paper import paper_pair


@pytest.fixture(scope="module")
def text(compensation) -> str:
    return c_header(compensation, ORIGIN, name="rig")


@pytest.fixture(scope="module")
def program(text, tmp_path_factory):
    return compiled(tmp_path_factory.mktemp("header"), text, "rig")


@needs_cc
@pytest.mark.parametrize("margin", [0.0, 0.2])
def test_over_the_hunting_period_it_is_the_map(grid, compensation, program, margin):
    first, second = readings(grid, np.linspace(0, 1, len(ANGLES)))
    backlash, slope, shift, per_rad, status = called(
        program, wrapped(first), wrapped(second), margin
    )
    assert not status.any()
    closing = compensation.closing_rad_per_mm
    np.testing.assert_allclose(backlash, grid.over(ANGLES), atol=1e-10)
    np.testing.assert_allclose(
        shift, np.maximum(0, grid.over(ANGLES) / closing - margin), atol=5e-8
    )
    # The oracle with the same harmonics: rounding alone is left.
    expected = shift_at(compensation, wrapped(first), wrapped(second), margin)
    np.testing.assert_allclose(shift, expected.shift_mm, atol=1e-11)
    np.testing.assert_allclose(per_rad, expected.slope_mm_per_rad, atol=1e-10)
    assert (margin > 0) == bool((shift == 0).any())
    # The slope along the motion against differences of the map.
    step = 1e-5
    differences = (grid.over(ANGLES + step) - grid.over(ANGLES - step)) / (2 * step)
    np.testing.assert_allclose(slope, differences, atol=1e-8)


@needs_cc
def test_what_is_no_angle_or_no_margin_is_unknown(program):
    bad = np.array([math.nan, math.inf, -math.inf, 1.1e9, -1e300])
    for angles in ((bad, 0.0), (0.0, bad), (bad, bad)):
        found = called(program, *angles, 0.0)
        assert not found[:4].any() and np.all(found[4] == 11)
    found = called(program, 0.0, 0.0, [math.nan, math.inf, -1e-9])
    assert np.all(found[4] == 1) and not found[2:4].any() and np.all(found[0] > 0)


@needs_cc
def test_it_knows_what_the_oracle_knows(grid, compensation, program):
    generator = np.random.default_rng(2)
    first, second = generator.uniform(-50, 50, (2, 20_000))
    near = readings(grid, angles=first)[1] + generator.uniform(-2, 2, len(first)) * (
        compensation.tolerance_rad
    )
    for driven in (second, near):
        known = gap_at(compensation, first, driven).known
        found = called(program, first, driven, 0.0)
        np.testing.assert_array_equal(found[4] == 0, known)
        assert 0.001 < known.mean() < 0.999
        assert not found[:4, ~known].any()


@needs_cc
def test_its_sine_and_its_turns_are_those_of_the_library(tmp_path, text):
    program = compiled(tmp_path, text, "rig", headers.ARITHMETIC)
    angles = np.concatenate([np.linspace(-1e5, 1e5, 50_001), np.linspace(-8, 8, 50_001)])
    wound = 1e4 * angles
    sine, cosine, within, *_ = called(program, angles, wound, 0.0)
    np.testing.assert_allclose(sine, np.sin(angles), atol=1e-15)
    np.testing.assert_allclose(cosine, np.cos(angles), atol=1e-15)
    assert np.abs(within).max() <= np.pi * (1 + 1e-9)
    # The parts of a turn are exact for these numbers of turns, and for all below 2²⁸.
    np.testing.assert_allclose(np.sin(within), np.sin(wound), atol=1e-14)
    np.testing.assert_allclose(np.cos(within), np.cos(wound), atol=1e-14)


@needs_cc
def test_mounted_and_perfect_pairs(tmp_path):
    rig = Eccentricities(constant_backlash_deg=0.04)
    perfect = BacklashMap(exact_model(paper_pair(), rig), None, paper_pair())
    found = compensation_of(perfect, allowed_rad=ALLOWED)
    assert found.terms == ()
    found = dataclasses.replace(found, offset_rad=found.offset_rad + 40.0)
    program = compiled(tmp_path, c_header(found, ORIGIN, name="perfect"), "perfect")
    backlash, slope, _, _, status = called(program, ANGLES, 45 / 80 * ANGLES + 40.0, 0.0)
    assert not status.any() and not slope.any()
    np.testing.assert_allclose(backlash, 0.04 * DEG, rtol=1e-12)


@needs_cc
def test_the_backlash_of_a_drive_whose_driven_shaft_is_fast(tmp_path):
    grid = drive_map(Fraction(255, 2))
    found = compensation_of(grid, allowed_rad=ALLOWED)
    text = c_header(found, ORIGIN, name="drive", quantity="backlash")
    assert "shift" not in text and "_mm" not in text
    program = compiled(tmp_path, text, "drive", headers.BACKLASH)
    places = [wrapped(angles) for angles in readings(grid)]
    backlash, slope, *_, status = called(program, *places, 0.0)
    assert not status.any()
    np.testing.assert_allclose(backlash, grid.over(ANGLES), atol=1e-10)
    np.testing.assert_allclose(slope, gap_at(found, *places).slope, atol=1e-10)


@needs_cc
@pytest.mark.skipif(headers.CXX is None, reason="no C++ compiler (`c++`) on this machine")
@pytest.mark.parametrize(
    ("compiler", "standard", "language"),
    [(headers.CXX, "-std=c++11", "c++"), (headers.CC, "-std=c99", "c")],
)
def test_two_of_them_in_one_program(tmp_path, compensation, text, compiler, standard, language):
    name = "other_rig_with_a_longer_name_31"
    (tmp_path / "rig.h").write_text(text)
    (tmp_path / "other.h").write_text(c_header(compensation, ORIGIN, name=name))
    status = f"rig_backlash(0, 0).status + {name}_shift(0, 0, 0).status"
    source, program = tmp_path / "both", tmp_path / "both.out"
    includes = "".join(f'#include "{one}.h"\n' for one in ("rig", "other", "rig"))
    source.write_text(f"{includes}int main({'void' * (language == 'c')}) {{ return {status}; }}\n")
    flags = [standard, "-Wall", "-Wextra", "-Werror", "-pedantic", "-x", language]
    command = [str(compiler), *flags, str(source), "-o", str(program)]
    subprocess.run(command, check=True, capture_output=True)
    subprocess.run([str(program)], check=True)


@needs_cc
def test_fast_math_is_refused(tmp_path, text):
    with pytest.raises(subprocess.CalledProcessError) as refused:
        compiled(tmp_path, text, "rig", flags=("-std=c99", "-ffast-math"))
    assert "compile without it" in refused.value.stderr


def test_it_needs_nothing_keeps_nothing_and_repeats_itself(compensation, text):
    assert text.isascii()
    assert "#include" not in text and "alloc" not in text.split("*/", 1)[1]
    assert c_header(compensation, ORIGIN, name="rig") == text
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    statics = re.findall(r"^\s*static (\w+)", code, flags=re.MULTILINE)
    assert set(statics) == {"inline", "const"}
    loops = re.findall(r"for \((.*?)\)", code)
    assert loops and all(re.fullmatch(r"k = 0; k < \d+; \+\+k", loop) for loop in loops)
    assert "while" not in code
    names = set(re.findall(r"(?:struct|double|void) (\w+?)(?: \{|\()", code))
    assert names and all(name.startswith("rig_") for name in names)
    assert max(map(len, text.splitlines())) < 140


def test_the_head_says_what_it_is(compensation):
    origin = HeaderOrigin("rig", "1.2.3", "reading", ("perfect_encoders",), "ab12")
    head = c_header(compensation, origin, name="rig").split("*/")[0]
    words = " ".join(head.replace(" *", " ").split())
    tolerance = f"{compensation.tolerance_rad / DEG:.6f} deg"
    said = ("1.2.3", "9/16", "16 driving turns", "read zero", "RIG_UNKNOWN", tolerance)
    assert all(one in words for one in (*said, "perfect_encoders", "ab12"))


@given(st.text(max_size=60))
def test_no_name_of_a_pair_leaves_its_comment_or_ascii(name):
    one = np.array([1e-4])
    small = Compensation(Fraction(9, 16), 7e-4, ((1, 0),), one, one, 1e-3, 0.0, 1e-3, 0.0)
    prefix = identifier_of(name)
    assert check_identifier(prefix) == prefix and prefix.islower()
    text = c_header(small, dataclasses.replace(ORIGIN, pair=name), name=prefix)
    assert text.isascii() and text.isprintable() == ("\n" not in text)
    head, _, rest = text.partition("*/")
    assert head.count("/*") == 1 and rest.lstrip().startswith("#if")


@pytest.mark.parametrize("name", ["", "2x", "_x", "a-b", "ä", "x" * 32])
def test_names_c_does_not_have_are_refused(name):
    with pytest.raises(UsageError) as caught:
        check_identifier(name)
    assert caught.value.where == "--name"
