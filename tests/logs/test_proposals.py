"""What `inspect` gives to copy if only the user knows which column is which shaft."""

import shlex

import jsonschema
import numpy as np
import pytest

from tests.logs.rig_log import angles_deg, csv
from vttig_jax.base.files.json_io import load_schema
from vttig_jax.logs.preview import preview_log
from vttig_jax.logs.recognition.request import DriveRequest

T, X, Y = angles_deg()

pytestmark = pytest.mark.smoke


@pytest.fixture
def seen(tmp_path):
    """Return the preview of a log with these columns."""

    def preview(head: str, *columns: np.ndarray, **stated):
        path = tmp_path / "log.csv"
        path.write_text(csv(head, *columns))
        report = preview_log(path, **stated)
        jsonschema.validate(report.to_json(), load_schema("vttig.inspect/1"))
        return report

    return preview


@pytest.mark.parametrize("sign", [1, -1])
def test_two_columns_without_names_give_both_readings(seen, sign):
    report = seen("t [s],p [deg],q [deg]", T, X, sign * Y)
    first, second = report.proposals
    assert first.condition.startswith(
        "`p [deg]` drives `q [deg]`: the driving shaft turns 16 times"
    )
    assert second.condition.startswith(
        "`q [deg]` drives `p [deg]`: the driving shaft turns 9 times"
    )
    words = shlex.split(first.command)
    assert words[:2] == ["vttig", "fit"] and words[words.index("--ratio") + 1] == "16:9"
    assert ("--invert driven" in first.command) == (sign < 0)
    text = str(report)
    assert all(one.command in text and one.condition in text for one in report.proposals)


def test_a_shaft_that_a_name_tells_stays(seen):
    (only,) = seen("t [s],motor [deg],q [deg]", T, X, Y).proposals
    assert "`motor [deg]` drives `q [deg]`" in only.condition


def test_counts_are_those_of_the_shaft_and_not_of_the_column(seen):
    """The second reading exchanges the shafts, so the counts of both encoders, too."""
    counts = [np.rint(one / 360 * 90000).astype(int) for one in (X, Y)]
    request = DriveRequest(counts=(90000, 45000))
    ratios = {
        shlex.split(one.command)[shlex.split(one.command).index("--ratio") + 1]
        for one in seen("t [s],e1,e2", T, *counts, request=request).proposals
    }
    assert ratios == {"8:9", "9:32"}


def test_a_unit_that_is_missing_is_asked_for_and_nothing_is_proposed(seen):
    report = seen("t [s],p,q", T, X, Y)
    assert report.proposals == ()
    told = " ".join(str(report).split())
    assert "give --unit deg (or rad, rev), or --counts A,B" in told
    assert "is printed here once options of `vttig inspect` answer these questions" in told


def test_columns_that_do_not_turn_together_are_no_pair(seen):
    other = 30 * np.sin(1.7 * T)
    assert seen("t [s],p [deg],q [deg]", T, X, other).proposals == ()
    names = {
        one.condition.split(":")[0]
        for one in seen("t [s],p [deg],q [deg],r [deg]", T, X, Y, other).proposals
    }
    assert names == {"`p [deg]` drives `q [deg]`", "`q [deg]` drives `p [deg]`"}


def test_a_constant_column_is_told_in_the_table_and_where_columns_are_listed(seen):
    report = seen("t [s],p [deg],q [deg]", T, X, np.full(len(T), 7.25))
    (row,) = [
        line for line in str(report).splitlines() if " q [deg]" in line and "note" not in line
    ]
    assert "constant" in row and row.count("7.25") == 2
    assert "left out, as they do not change: `q [deg]` (always 7.25)" in " ".join(
        str(report).split()
    )
    (moves,) = [line for line in str(report).splitlines() if line.strip().startswith("p [deg]")]
    assert "constant" not in moves


def test_two_columns_of_one_named_role_are_no_pair(seen):
    """The axes of a robot: two motors that move together are not the shafts of one drive."""
    head = "t [s],mot1 [deg],mot2 [deg],q1 [deg],q2 [deg]"
    noisy = 1.02 * X + 30 * np.sin(T)
    other = noisy + np.sin(3 * T)
    found = [
        one.condition.split(":")[0] for one in seen(head, T, X, noisy, X / 10, other).proposals
    ]
    best = {"`mot1 [deg]` drives `q1 [deg]`", "`mot2 [deg]` drives `q2 [deg]`"}
    assert set(found[:2]) == best
    assert not [one for one in found if one.count("mot") == 2 or one.endswith("`mot1 [deg]`")]


def test_a_log_of_the_transmission_error_has_no_ratio_to_propose(seen):
    report = seen("time_s,driving_deg,transmission_error_arcsec", T, X, np.sin(X))
    assert "this log shows no ratio" in " ".join(str(report).split())
    assert "answer these questions" not in str(report)
