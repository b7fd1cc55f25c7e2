"""Texts with several tables: which section is taken, what is said, and what is asked."""

import numpy as np
import pytest

import vttig_jax
from tests.logs.rig_log import GAP_DEG, angles_deg, csv
from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers.open_table import open_table

T, X, Y = angles_deg()
WARM_UP = csv("Time,Temp A,Temp B", T[:50], 20 + 0 * X[:50], 21 + 0 * X[:50])
RUN = csv("Time,Motor [deg],Load [deg],state", T, X, Y, ["ok"] * len(T))


@pytest.fixture
def save(tmp_path):
    def write(text):
        path = tmp_path / "log.txt"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def report(run: str = RUN, mark: str = ",") -> str:
    lines = run.replace(",", mark).splitlines()
    lines.insert(30, "INFO: the table was touched")
    lines.insert(60, mark.join(["0.58", "", "", "DROP"]))
    before = ["Bench 2.1", "", "Warm-up begins at 10:00", WARM_UP.replace(",", mark), "Ended", ""]
    return "\n".join([*before, "Run begins at 10:05", "Gain = 1.2", *lines, "Run ends", ""])


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_the_only_section_with_both_shafts_is_taken(save, mark):
    log = vttig_jax.read_log(save(report(mark=mark)), ratio="16:9")
    assert len(log) == len(T) and log.spec is not None and log.spec.log.time == "2/Time"
    np.testing.assert_allclose(log.driving.reading, X, atol=1e-6)
    gap = vttig_jax.fit(log, delay="off").parameters["constant_backlash_deg"].value
    assert gap == pytest.approx(GAP_DEG, abs=1e-4)


def test_sections_are_told(save):
    table = open_table(save(report()))
    notes = table.notes
    assert table.names == (
        *("1/Time", "1/Temp A", "1/Temp B"),
        *("2/Time", "2/Motor [deg]", "2/Load [deg]"),
    )
    first, second = notes
    assert first.startswith("section 1 `Warm-up begins at 10:00` at line 4: 50 rows;")
    assert f"section 2 `Run begins at 10:05` at line 60: {len(T)} rows" in second
    assert "2 lines between them are left out, the first is line 90" in second
    assert "--column driving=2/NAME" in second


def test_two_runs_are_asked_for_and_chosen(save):
    path = save(f"Run A\n{RUN}\nRun B\n{csv('Time,Motor [deg],Load [deg]', T, X + 7, Y + 1)}")
    with pytest.raises(LogError, match=r"--column driving='1/Motor \[deg\]' or"):
        vttig_jax.read_log(path, ratio="16:9")
    for number, start in ((1, X[0]), (2, X[0] + 7)):
        log = vttig_jax.read_log(path, ratio="16:9", columns={"driving": f"{number}/Motor"})
        assert log.spec is not None and log.spec.log.driven == f"{number}/Load [deg]"
        assert log.spec.log.time == f"{number}/Time" and len(log) == len(T)
        again = vttig_jax.read_log(path, log.spec)
        np.testing.assert_array_equal(again.driving.reading, log.driving.reading)
        assert log.driving.reading[0] == pytest.approx(start, abs=1e-6)


def test_a_header_that_is_written_again_begins_a_section(save):
    with pytest.raises(LogError, match="2 columns can be driving"):
        vttig_jax.read_log(save(RUN + RUN), ratio="16:9")


@pytest.mark.parametrize(
    "text",
    [
        RUN.replace("0.100000,", "zero,", 1),
        RUN.replace("\n0.10,", "\nbad,", 1),
        "\n".join([*RUN.splitlines()[:40], "one,two,three,four", *RUN.splitlines()[40:]]),
    ],
)
def test_a_damaged_row_begins_no_section(save, text):
    table = open_table(save(text))
    assert table.names[0] == "Time"


def test_text_in_a_column_of_a_section(save):
    wrong = report().replace(RUN.splitlines()[200], "2.0,much,5.0,ok")
    with pytest.raises(LogError, match=r"line \d+: `much` is no number") as caught:
        open_table(save(wrong))
    assert "section 2, column `Motor [deg]`" in caught.value.where
