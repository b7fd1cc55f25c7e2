"""CSV files of measured flanks and pitches: what they say, and every way to be none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import InputError
from vttig_jax.geometry.contact.deviations_file import read_deviations
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
    """And further columns, spaces, blank lines and a byte-order mark do no harm."""
    table = [(*line.split(","), "ok") for line in (HEAD, *GRID)]
    table = [table[0], *(table[1 + place] for place in order)]
    lines = [" , ".join(row[place] for place in columns) for row in table]
    path = tmp_path_factory.mktemp("order") / "measured.csv"
    path.write_text("\ufeff" + "\n\n".join(lines), "utf-8")
    (drawn,) = read_deviations(path, pair=PAIR).maps
    np.testing.assert_array_equal(drawn.deviation_um, np.outer([8.0, 10.0, 12.5], [-9.0, 9.0]))


def test_pitches_of_one_flank_leave_the_other_as_drawn(tmp_path):
    found = read_deviations(pitches=write(tmp_path, PITCH_HEAD, *TEETH[::-1]), pair=PAIR)
    assert found.maps == () and found.driven_pitch_um is None
    expected = [[0.1, 0.2, 0.3, 0.4], [0.0, 0.0, 0.0, 0.0]]
    np.testing.assert_array_equal(found.driving_pitch_um, expected)
    assert "driving pitch A  4 teeth, 0.10 … 0.40 µm" in str(found) and "pitch B" not in str(found)


def test_nothing_is_nothing():
    assert str(read_deviations(pair=PAIR)).endswith("none  –")


def changed(place: int, text: str) -> tuple[str, ...]:
    return (HEAD, *GRID[: place - 2], text, *GRID[place - 1 :])


BAD = {
    "missing column": (("gear,flank,roll_mm,deviation_um", "driven,B,8,1"), 1, "no column `z_mm`"),
    "doubled column": ((f"{HEAD},z_mm", "driven,B,8,1,2,3"), 1, "2 columns `z_mm`"),
    "semicolons": ((HEAD.replace(",", ";"),), 1, "no column `gear`"),
    "empty": (("", ""), 1, f"empty; write the header {HEAD}"),
    "header alone": ((HEAD,), 1, "nothing is below the header; give a line for each roll"),
    "decimal comma": (changed(4, "driven,B,10,0,-9,1"), 4, "6 fields, but the header has 5"),
    "cut off": ((HEAD, *GRID[:-1], "driven,B,12.5"), 7, "3 fields, but the header has 5"),
    "word": (changed(3, "driven,B,8,top,1"), 3, "'top' is not a number for z_mm"),
    "not finite": (changed(3, "driven,B,8,9,nan"), 3, "'nan' is not a number for deviation_um"),
    "empty field": (changed(3, "driven,B,8,9,"), 3, "'' is not a number for deviation_um"),
    "gear": (changed(5, "pinion,B,10,9,1"), 5, "'pinion' is not a gear; write driving or driven"),
    "flank": (changed(5, "driven,left,10,9,1"), 5, "'left' is not a flank; write A or B"),
    "doubled": ((HEAD, *GRID, GRID[2]), 8, r"z = -9 mm in line 4 already; keep one of them"),
    "hole": ((HEAD, *GRID[:-1]), 6, r"no point at roll length 12\.5 mm and z = 9 mm.*3 × 2 points"),
    "one height": ((HEAD, *GRID[::2]), 2, "driven flank B has a single height"),
    "one roll": ((HEAD, *GRID[:2]), 2, "driven flank B has a single roll length"),
    "diameter": (changed(6, "driven,B,94,-9,1"), 6, r"roll length 94 mm is not on the driven fl"),
    "negative": (changed(6, "driven,B,-1,-9,1"), 6, "roll length -1 mm is not on the driven flank"),
    "from an end": (changed(6, "driven,B,12.5,20,1"), 6, r"off the driven face \(-10 to 10 mm\)"),
    "nanometres": (changed(3, "driven,B,8,9,5001"), 3, r"more than a quarter of the module \(5000"),
    "a field too long": ((HEAD, "x" * 200_000), 2, "not CSV"),
}


@pytest.mark.parametrize("name", BAD)
def test_files_that_are_no_maps(tmp_path, name):
    lines, line, sentence = BAD[name]
    path = write(tmp_path, *lines)
    with pytest.raises(InputError, match=sentence) as raised:
        read_deviations(path, pair=PAIR)
    assert raised.value.where == f"{path}: line {line}" and raised.value.exit_code == 3
    assert "\n" not in str(raised.value)


BAD_PITCHES = {
    "no such tooth": (
        (*TEETH, "driving,A,5,1"),
        6,
        "5 is not a tooth of the driving gear; count te",
    ),
    "half a tooth": ((*TEETH[:3], "driving,A,3.5,1"), 5, r"3\.5 is not a tooth"),
    "missing tooth": ((*TEETH[:1], *TEETH[2:]), 4, "driving flank A has no tooth 2; give all 4"),
    "metres": (("driving,A,1,2e6", *TEETH[1:]), 2, "a deviation of 2e\\+06 µm is more than"),
    "doubled": ((*TEETH, TEETH[0]), 6, "tooth 1 in line 2 already"),
}


@pytest.mark.parametrize("name", BAD_PITCHES)
def test_files_that_are_no_pitches(tmp_path, name):
    lines, line, sentence = BAD_PITCHES[name]
    path = write(tmp_path, PITCH_HEAD, *lines)
    with pytest.raises(InputError, match=sentence) as raised:
        read_deviations(pitches=path, pair=PAIR)
    assert raised.value.where == f"{path}: line {line}"


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_deviations(tmp_path / "nowhere.csv", pair=PAIR)
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_deviations(tmp_path, pair=PAIR)
    path = tmp_path / "latin.csv"
    path.write_bytes("gear,flank,tooth,µm".encode("latin-1"))
    with pytest.raises(InputError, match="byte 17 is not UTF-8; save it as UTF-8 text"):
        read_deviations(pitches=path, pair=PAIR)
