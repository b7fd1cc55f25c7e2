"""First looks at nested files, at text without a header and at a log that was cut off."""

import jsonschema
import numpy as np
import pytest
from scipy.io import savemat

from vttig_jax.base.errors import LogError
from vttig_jax.base.files.json_io import load_schema
from vttig_jax.logs.preview import MOST_COLUMNS, preview_log
from vttig_jax.logs.recognition.request import DriveRequest

pytestmark = pytest.mark.smoke

COUNT = 50
ANGLES = np.outer([1.0, 0.5], 20.0 * np.arange(COUNT))
NAMED = {"driving": "pos_deg(1,:)", "driven": "pos_deg(2,:)"}


def mat(tmp_path, **arrays):
    path = tmp_path / "log.mat"
    savemat(path, {"rec": {"time_s": np.arange(COUNT) / 10, "pos_deg": ANGLES} | arrays})
    return path


def flat(report):
    return " ".join(str(report).split())


def checked(report):
    found = report.to_json()
    jsonschema.validate(found, load_schema("vttig.inspect/1"))
    return found


def test_a_nested_file(tmp_path):
    seen = preview_log(mat(tmp_path), columns=NAMED)
    found = checked(seen)
    assert [(c["role"], c["name"]) for c in found["columns"]] == [
        ("time", "rec.time_s"),
        ("driving", "rec.pos_deg(1,:)"),
        ("driven", "rec.pos_deg(2,:)"),
    ]
    assert found["samples"] == {"read": COUNT} and "other_arrays" not in found
    assert seen.ratio is not None and seen.ratio[0] == pytest.approx(0.5)
    assert seen.sampling is not None and seen.sampling.rate_hz == pytest.approx(10.0)
    assert [c.turns for c in seen.columns][1] == pytest.approx(49 / 18)


def test_arrays_of_other_lengths_are_listed_with_theirs(tmp_path):
    path = mat(tmp_path, gains=np.arange(3.0), slow=np.zeros((2, 70)))
    seen = preview_log(path)
    assert checked(seen)["other_arrays"] == [
        {"name": "rec.gains", "values": 3},
        {"name": "rec.slow(1,:)", "values": 70},
        {"name": "rec.slow(2,:)", "values": 70},
    ]
    assert len(seen.columns) == 3
    text = flat(seen)
    assert "arrays of 70 values are no part of this record of 50: rec.slow(1…2,:)" in text
    assert "arrays of 3 values" in text


def test_the_driving_column_tells_the_length(tmp_path):
    path = mat(tmp_path, fine_deg=np.linspace(0, 900, 400))
    seen = preview_log(path, columns={"driving": "fine_deg", "driven": "pos_deg(2,:)"})
    assert seen.rows == 400 and len(seen.columns) == 1
    assert seen.ratio is None and seen.sampling is None
    text = flat(seen)
    assert "`rec.pos_deg(2,:)` cannot be the driven of this record of 400 samples" in text
    assert "`rec.time_s` cannot be the time" in text
    checked(seen)


def test_many_columns_of_one_matrix_are_one_line(tmp_path):
    path = mat(tmp_path, force=np.outer(np.arange(MOST_COLUMNS), np.ones(COUNT)), x=np.ones(COUNT))
    seen = preview_log(path, columns={"driving": "pos_deg(2,:)"})
    lines = str(seen).partition("\nnote:")[0].splitlines()
    (line,) = (one for one in lines if "force" in one)
    assert f"rec.force(1…{MOST_COLUMNS},:)" in line
    assert line.split()[2:4] == ["0", str(MOST_COLUMNS - 1)]
    assert sum("pos_deg" in one for one in lines) == 2  # one plays a part
    assert len(seen.columns) == MOST_COLUMNS + 4
    few = flat(preview_log(mat(tmp_path, force=np.ones((3, COUNT)))))
    assert "force(3,:)" in few


def test_names_that_are_not_there(tmp_path):
    with pytest.raises(LogError, match=r"no column speed; the log has rec\.time_s"):
        preview_log(mat(tmp_path), columns={"driving": "speed"})
    with pytest.raises(LogError, match="no column #9; the log has"):
        preview_log(mat(tmp_path), columns={"driving": "#9"})


def test_text_without_a_header(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("".join(f"{k / 10},{7.5 * k},{k}.25\n" for k in range(COUNT)))
    seen = preview_log(path)
    assert [c.name for c in seen.columns] == ["#1", "#2", "#3"]
    assert all(c.role is None for c in seen.columns)
    named = preview_log(path, columns={"time": "#1", "driving": "#2", "driven": "#3"})
    assert [c.role for c in named.columns] == ["time", "driving", "driven"]
    assert named.sampling is not None and named.sampling.rate_hz == pytest.approx(10.0)
    assert "`#2` 0, 7.5, 15, … (0 … 367.5) for driving names no unit" in flat(named)
    with pytest.raises(LogError, match="no column #4; the log has 3"):
        preview_log(path, columns={"driving": "#4"})


@pytest.mark.parametrize(
    ("names", "asked"),
    [
        ("t_s,motor enc_deg,motor actual_deg,load_deg", "2 columns can be driving"),
        ("t_s,motor_deg,load_deg,output_deg", "2 columns can be driven"),
        ("t_s,motor Soll_deg,x_deg,load_deg", "says a setpoint"),
        ("t_s,a,b,c", "give --ratio A:B (driving turns to driven turns)"),
    ],
)
def test_a_question_on_the_shafts_does_not_hide_the_time(tmp_path, names, asked):
    """`fit` takes the same time column as soon as the shafts are named."""
    path = tmp_path / "log.csv"
    rows = (f"{k / 10},{x},{x + 0.25},{x / 2}\n" for k, x in enumerate(ANGLES[0] % 300))
    path.write_text(names + "\n" + "".join(rows))
    seen = preview_log(path)
    assert [c.name for c in seen.columns if c.role == "time"] == ["t_s"]
    assert seen.sampling is not None and asked in flat(seen)
    assert "no column is certainly the time" not in flat(seen) and seen.fit_command == ""


def test_all_questions_are_asked_at_once(tmp_path):
    path = tmp_path / "log.csv"
    rows = (f"{k},{x},{x / 2}\n" for k, x in enumerate(ANGLES[0] % 300))
    path.write_text("t,motor,load\n" + "".join(rows))
    text = flat(preview_log(path))
    assert "--unit time=s, ms, us or ns" in text and "for driving names no unit" in text


def test_the_number_of_the_row_as_a_column(tmp_path):
    path = tmp_path / "lookup.csv"
    path.write_text("".join(f"{k * 7.2:.2f}\n" for k in range(COUNT)))
    seen = preview_log(path, columns={"driving": "#row", "driven": "#1"}, sample_rate_hz=10)
    found = checked(seen)
    assert {c["role"]: c["name"] for c in found["columns"]} == {"driven": "#1", "driving": "#row"}
    rows = next(c for c in seen.columns if c.role == "driving")
    assert (rows.low, rows.high) == (0, COUNT - 1)
    timed = preview_log(path, columns={"time": "#row", "driving": "#1"})
    assert timed.sampling is not None and timed.sampling.rate_hz == pytest.approx(1.0)


def test_a_line_that_was_cut_off_is_left_out(tmp_path):
    path = tmp_path / "log.csv"
    rows = "".join(f"{k / 10},{k},{k}.25\n" for k in range(COUNT))
    path.write_text("time_s,driving_deg,driven_deg\n" + rows + "5.0,5")
    seen = preview_log(path)
    assert seen.rows == COUNT
    assert f"the last line ({COUNT + 2}) is cut off and left out" in flat(seen)
    path.write_text("time_s,driving_deg,driven_deg\n" + rows)
    assert "cut off" not in flat(preview_log(path))


@pytest.mark.parametrize("content", ["", "words only\nand more\n", "time_s,driving_deg\n"])
def test_what_holds_no_table(tmp_path, content):
    path = tmp_path / "log.csv"
    path.write_text(content)
    with pytest.raises(LogError):
        preview_log(path)


def test_counts_that_the_user_states_give_turns_and_the_ratio(tmp_path):
    path = tmp_path / "log.csv"
    turns = 0.01 * np.arange(500)
    rows = np.rint(np.column_stack([4096 * turns, 20000 * turns * 23 / 64])).astype(int).tolist()
    text = [f"{k / 100},{a},{b}" for k, (a, b) in enumerate(rows)]
    path.write_text("\n".join(["time_s,motor,load", *text]))
    report = preview_log(path, request=DriveRequest(counts=(4096, 20000)))
    assert "--ratio 64:23 --counts 4096,20000" in report.fit_command
    assert report.columns[1].turns == pytest.approx(4.99, abs=1e-3)
    assert "give --counts" not in flat(report)
    unknown = preview_log(path, request=DriveRequest(units={"driving": "counts"}))
    assert unknown.columns[1].turns is None


def test_questions_are_records_in_the_json(tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{k / 10},{900 * k},{450 * k}" for k in range(COUNT)]
    path.write_text("\n".join(["t_s,motor_counts,load_counts", *rows]))
    (asked,) = checked(preview_log(path))["questions"]
    assert (asked["slug"], asked["role"]) == ("no-counts", "driving")
    assert asked["columns"] == ["motor_counts"] and "--counts" in asked["options"][0]
    counted = DriveRequest(counts=(3600, 3600))
    assert "questions" not in checked(preview_log(path, request=counted))
