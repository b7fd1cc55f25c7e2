"""CSV files of measured flanks and pitches: what they say, and every way to be none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import InputError
from vttig_jax.logs.readers.backlash_readings import read_deviations
from vttig_jax.pair.gear_pair import Gear, GearPair

pytestmark = pytest.mark.smoke

PAIR = GearPair(Gear(4), Gear(3, face_width_mm=20.0), module_mm=20.0, pressure_angles_deg=20.0)
HEAD = "gear,flank,roll_mm,z_mm,deviation_um"
GRID = [f"driven,B,{roll},{z},{roll * z}" for roll in (8, 10, 12.5) for z in (-9, 9)]
TEETH = [f"driving,A,{tooth},{tooth / 10}" for tooth in (1, 2, 3, 4)]
PITCH_HEAD = "gear,flank,tooth,deviation_um"


def write(folder, *lines):
    path = folder / "measured.csv"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def test_a_grid_is_a_map(tmp_path):
    found = read_deviations(write(tmp_path, HEAD, *GRID), pair=PAIR)
    assert found.driving == (None, None) and found.driven[0] is None
    drawn = found.driven[1]
    assert drawn is not None and found.driven_pitch_um is None
    np.testing.assert_array_equal(drawn.roll_mm, [8.0, 10.0, 12.5])
    np.testing.assert_array_equal(drawn.z_mm, [-9.0, 9.0])
    np.testing.assert_array_equal(drawn.deviation_um, np.outer([8.0, 10.0, 12.5], [-9.0, 9.0]))


@given(order=st.permutations(range(6)), columns=st.permutations(range(6)))
def test_order_of_lines_and_columns_is_free(tmp_path_factory, order, columns):
    """Further columns, blanks, a byte-order mark and other delimiters and marks do no harm."""
    table = [(*line.split(","), "ok") for line in (HEAD, *GRID)]
    table = [table[0], *(table[1 + place] for place in order)]
    lines = [" , ".join(row[place] for place in columns) for row in table]
    text, path = "\ufeff" + "\n\n".join(lines), tmp_path_factory.mktemp("order") / "measured.csv"
    for shown in (text, text.replace(",", ";").replace(".", ",")):
        path.write_text(shown, "utf-8")
        (drawn,) = read_deviations(path, pair=PAIR).maps
        np.testing.assert_array_equal(drawn.deviation_um, np.outer([8, 10, 12.5], [-9, 9]))


def test_pitches_of_one_flank_leave_the_other_as_drawn(tmp_path):
    found = read_deviations(pitches=write(tmp_path, PITCH_HEAD, *TEETH[::-1]), pair=PAIR)
    assert found.maps == () and found.driven_pitch_um is None
    assert str(read_deviations(pair=PAIR)).endswith("none  –")
    expected = [[0.1, 0.2, 0.3, 0.4], [0.0, 0.0, 0.0, 0.0]]
    np.testing.assert_array_equal(found.driving_pitch_um, expected)
    assert "driving pitch A  4 teeth, 0.10 … 0.40 µm" in str(found) and "pitch B" not in str(found)


def changed(place: int, text: str) -> tuple[str, ...]:
    return (HEAD, *GRID[: place - 2], text, *GRID[place - 1 :])


BAD = {
    "missing column": ("gear,flank,roll_mm,deviation_um", "driven,B,8,1"),
    "doubled column": (f"{HEAD},z_mm", "driven,B,8,1,2,3"),
    "empty": ("", ""),
    "header alone": (HEAD,),
    "decimal comma": changed(4, "driven,B,10,0,-9,1"),
    "cut off": (HEAD, *GRID[:-1], "driven,B,12.5"),
    "word": changed(3, "driven,B,8,top,1"),
    "not finite": changed(3, "driven,B,8,9,nan"),
    "empty field": changed(3, "driven,B,8,9,"),
    "gear": changed(5, "pinion,B,10,9,1"),
    "flank": changed(5, "driven,left,10,9,1"),
    "doubled": (HEAD, *GRID, GRID[2]),
    "hole": (HEAD, *GRID[:-1]),
    "one height": (HEAD, *GRID[::2]),
    "one roll": (HEAD, *GRID[:2]),
    "diameter": changed(6, "driven,B,94,-9,1"),
    "negative": changed(6, "driven,B,-1,-9,1"),
    "from an end": changed(6, "driven,B,12.5,20,1"),
    "nanometres": changed(3, "driven,B,8,9,5001"),
    "a field too long": (HEAD, "x" * 200_000),
}
LINES = {"word": 3, "not finite": 3, "empty field": 3, "gear": 5, "flank": 5, "diameter": 6}
LINES |= {"negative": 6, "from an end": 6, "nanometres": 3, "doubled": 8, "cut off": 7}


@pytest.mark.parametrize("name", BAD)
def test_files_that_are_no_maps(tmp_path, name):
    path = write(tmp_path, *BAD[name])
    with pytest.raises(InputError) as raised:
        read_deviations(path, pair=PAIR)
    line = f": line {LINES[name]}" if name in LINES else ""
    assert raised.value.where.startswith(f"{path}{line}") and raised.value.exit_code == 3
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "lines",
    [
        (*TEETH, "driving,A,5,1"),
        (*TEETH[:3], "driving,A,3.5,1"),
        (*TEETH[:1], *TEETH[2:]),
        ("driving,A,1,2e6", *TEETH[1:]),
        (*TEETH, TEETH[0]),
    ],
    ids=["no such tooth", "half a tooth", "missing tooth", "metres", "doubled"],
)
def test_files_that_are_no_pitches(tmp_path, lines):
    path = write(tmp_path, PITCH_HEAD, *lines)
    with pytest.raises(InputError) as raised:
        read_deviations(pitches=path, pair=PAIR)
    assert raised.value.where.startswith(str(path))


def test_files_that_cannot_be_read(tmp_path):
    for path in (tmp_path / "nowhere.csv", tmp_path):
        with pytest.raises(InputError):
            read_deviations(path, pair=PAIR)
