"""The table of many logs beside single fits: equal numbers, refusals by name, and files."""

import csv
from fractions import Fraction
from io import StringIO
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import vttig_jax
from vttig_jax.base import LogError
from vttig_jax.identify import FitTable, fit_many
from vttig_jax.identify.many.fit_many import Unread, batch_settings, fit_columns
from vttig_jax.identify.many.table import table_of
from vttig_jax.logs import EncoderLog
from vttig_jax.pair import Drive, GearPair
from vttig_jax.rig import PassMotion, SyntheticRig, paper_pair, paper_rig

PARTS = {"": "value", "_std": "std", "_low95": "low95", "_high95": "high95"}


def rig_of(reversal_deg: float = 2880.0) -> SyntheticRig:
    return paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=reversal_deg, ramp_s=0.2))


@pytest.fixture(scope="module")
def rig():
    return rig_of()


def with_outliers(log: EncoderLog, pair: GearPair) -> EncoderLog:
    assert log.driving is not None and log.driven is not None
    driven = np.array(log.driven.reading)
    driven[500:-500:60] += 200
    return EncoderLog.from_arrays(log.time, log.driving.reading, driven, pair=pair)


def test_rows_are_single_fits(rig):
    """Logs of unequal length, one of few turns, one with outliers: each as one alone."""
    logs = [rig.log(0), rig_of(2000.0).log(1), with_outliers(rig.log(2), rig.pair)]
    table = fit_many(logs, rig.pair)
    assert table.columns["code"].tolist() == ["ok"] * 3
    for number, log in enumerate(logs):
        single = vttig_jax.fit(log, rig.pair)
        for name in set(single.parameters) & set(table.parameters):
            one = single.parameters[name]
            for part, field in PARTS.items():
                expected = np.array(getattr(one, field), float)  # NaN for None
                cell, near = table.columns[name + part][number], 1e-6 * (one.std or 1.0)
                np.testing.assert_allclose(cell, expected, rtol=0, atol=near, err_msg=name)
        assert table.columns["samples_used"][number] == single.samples["used"]
        assert table.columns["noise_std_deg"][number] == pytest.approx(single.noise.std_deg)
        assert table.columns["conditional_on"][number] == " ".join(single.conditional_on)
        undetermined = {n for n, p in single.parameters.items() if not p.determined}
        assert set(table.columns["undetermined"][number].split()) >= undetermined
    off = fit_many(logs[:1], rig.pair, delay="off")
    gap = "constant_backlash_deg"
    assert abs(off.columns[gap][0] - table.columns[gap][0]) > 1e-6  # another model, other numbers


def test_a_row_says_what_its_numbers_depend_on_and_another_rig_is_refused(rig):
    """One flank does not separate the gears from their encoders."""
    one = fit_many([rig.log(0)], rig.pair, flank="A", delay="off")
    assert one.columns["conditional_on"].tolist() == ["perfect_encoders no_delay"]
    assert one.columns["flanks"].tolist() == ["A"]
    assert "1 conditional on perfect_encoders no_delay" in str(one)
    log = rig.log(0)
    with pytest.raises(LogError, match="another rig") as error:
        fit_many([log], Drive(Fraction(1, 2)))
    assert error.value.where == log.source and "9/16" in error.value.message


def test_a_log_that_cannot_be_fitted_has_a_code_and_a_reason(rig):
    done = []
    time = np.arange(400) / 1000.0
    turned = (25 * np.arange(400)).astype(int)  # a ninth of a turn
    rest = EncoderLog.from_arrays(time, turned, turned * 9 // 16, pair=rig.pair)
    logs = [Unread("a.csv", LogError("broken.", where="a.csv")), rest, rig.log(0)]
    columns = fit_columns(
        logs, rig.pair, batch_settings(None, {}), rig.pair.fit, progress=done.append
    )
    assert columns["code"].tolist() == ["refused", "undetermined", "ok"]
    assert columns["reason"].tolist()[0] == "broken." and columns["reason"].tolist()[1]
    assert np.isnan(columns["constant_backlash_deg_std"][:2]).all() and done == [1, 1, 1]
    assert vttig_jax.fit(rest, rig.pair).outcome == "not_determined"


def test_rows_have_the_order_of_the_logs_and_few_are_in_memory(rig):
    seen, log = [], rig.log(0)

    def drawn():
        for number in range(30):
            assert number + 1 - len(seen) <= 2 * 4 + 2
            yield log if number % 10 == 0 else Unread(str(number), LogError("broken."))

    settings = batch_settings(None, {})
    columns = fit_columns(drawn(), rig.pair, settings, rig.pair.fit, progress=seen.append)
    expected = [str(number) if number % 10 else log.source for number in range(30)]
    assert columns["log"].tolist() == expected


def test_wrong_settings_and_arguments_of_another_kind_are_named(unchecked):
    for changes, words in (
        ({"same_zero": True}, "`same_zero`"),
        ({"use_readings": True}, "`use_readings`"),
        ({"flank": "C"}, "`flank` must be"),
    ):
        with pytest.raises(ValueError, match=words):
            batch_settings(None, changes)
    with pytest.raises(TypeError, match="no argument `drift`"):
        batch_settings(None, {"drift": 1})
    cases: list[tuple[Any, Any, str]] = [
        (["rig.csv"], paper_pair(), "must hold encoder logs, .* holds a str"),
        (None, paper_pair(), "must be an iterable of encoder logs, but is a NoneType"),
        ([], "pair.toml", "`pair` must be a gear pair or a drive, .* is a str"),
    ]
    for logs, pair, words in cases:
        with pytest.raises(TypeError, match=words):
            fit_many(logs, pair)


def test_the_table_is_written_as_csv_and_parquet(tmp_path):
    good = {"log": "a", "code": "ok", "samples_used": 7.0, "e_mm": 0.1 + 0.2, "e_mm_std": 1e-3}
    bad = {"log": "b,c", "code": "refused", "reason": "it has no samples"}
    table = FitTable(table_of([good, bad], ["e_mm"]), "rig")
    rows = list(csv.DictReader(StringIO(table.to_csv(tmp_path / "t.csv"))))
    assert float(rows[0]["e_mm"]) == 0.1 + 0.2 and rows[0]["samples_used"] == "7"
    assert rows[1]["log"] == "b,c" and rows[1]["e_mm"] == ""
    assert (tmp_path / "t.csv").read_text() == table.to_csv()
    table.to_parquet(tmp_path / "t.parquet")
    read = pq.read_table(tmp_path / "t.parquet")
    assert read.column("e_mm").to_pylist() == [0.1 + 0.2, None]
    assert len(table) == 2 and table.failures == (("b,c", "refused", "it has no samples"),)
    assert "2, 1 fitted" in str(table) and "b,c: it has no samples" in str(table)
