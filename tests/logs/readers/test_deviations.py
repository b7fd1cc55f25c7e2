"""CSV files of measured flanks and pitches: what they say; the corpus has those that are none."""

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


def test_files_that_cannot_be_read(tmp_path):
    for path in (tmp_path / "nowhere.csv", tmp_path, write(tmp_path, HEAD, "x" * 200_000)):
        with pytest.raises(InputError):
            read_deviations(path, pair=PAIR)
