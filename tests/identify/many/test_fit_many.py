"""The batch of logs beside single fits: shapes, refusals by name, and the table."""

import csv
import time
from fractions import Fraction
from io import StringIO
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from vttig_jax.identify.many.batch_model import BatchShape, rounded_up
from vttig_jax.identify.many.batches import Shapes, logs_at_once
from vttig_jax.identify.many.codes import Code
from vttig_jax.identify.many.preparation import batch_settings, prepare

import vttig_jax
from vttig_jax.base.errors import LogError, NoAnswerError
from vttig_jax.identify import FitTable
from vttig_jax.identify.many import fit_many as fit_many_module
from vttig_jax.identify.many.fit_many import Unread, fit_columns
from vttig_jax.identify.many.table import joined, table_of
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.rig import PassMotion, paper_pair, paper_rig


@pytest.fixture(scope="module")
def rig():
    return paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=2880.0, ramp_s=0.2))


def test_a_log_of_another_rig_is_refused_by_name(rig):
    log = rig.log(0)
    with pytest.raises(LogError, match="another rig") as error:
        vttig_jax.fit_many([log], Drive(Fraction(1, 2)))
    assert error.value.where == log.source and "9/16" in error.value.message


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"loss": "huber"}, ValueError, "`loss` must be square"),
        ({"delay": "free"}, ValueError, "`delay` must be"),
        ({"drift_order": None}, ValueError, "`drift_order` must be"),
        ({"noise": "white"}, ValueError, "`noise` must be ar"),
        ({"drift": 1}, TypeError, "no argument `drift`"),
    ],
)
def test_settings_that_a_batch_does_not_have(changes, kind, words):
    with pytest.raises(kind, match=words):
        batch_settings(changes)


@pytest.mark.parametrize(
    ("logs", "pair", "words"),
    [
        (["rig.csv"], paper_pair(), "must hold encoder logs, .* holds a str"),
        (None, paper_pair(), "must be an iterable of encoder logs, but is a NoneType"),
        ([], "pair.toml", "`pair` must be a gear pair or a drive, .* is a str"),
    ],
)
def test_arguments_of_another_kind_are_named(logs, pair, words):
    """Without the type checks of the tests, which would speak first."""

    def checked():
        fit_many_module._require_types(logs, pair)
        return [fit_many_module._encoder_log(log) for log in logs]

    with pytest.raises(TypeError, match=words):
        checked()


def test_a_row_says_what_its_numbers_depend_on(rig):
    """One flank does not separate the gears from their encoders."""
    both = vttig_jax.fit_many([rig.log(0)], rig.pair)
    one = vttig_jax.fit_many([rig.log(0)], rig.pair, flank="A")
    assert both.columns["conditional_on"].tolist() == [""]
    assert one.columns["conditional_on"].tolist() == ["perfect_encoders"]
    assert "1 conditional on perfect_encoders" in str(one)


def test_a_log_that_needs_terms_of_its_own_is_not_fitted(rig):
    spoilt = rig.log(0)
    driven = np.array(spoilt.driven.reading)
    driven[500:-500:60] += 200
    log = vttig_jax.EncoderLog.from_arrays(
        spoilt.time, spoilt.driving.reading, driven, pair=rig.pair
    )
    settings = batch_settings({})
    with pytest.raises(NoAnswerError, match="outliers"):
        prepare(log, rig.pair, settings, rig.pair.fit)
    assert prepare(spoilt, rig.pair, settings, rig.pair.fit).shape.runs == 1


def test_a_batch_without_a_fit_has_rows_with_reasons(rig):
    done = []
    columns = fit_columns(
        [Unread("a.csv", LogError("broken.", where="a.csv")), Unread("b", LogError("empty."))],
        rig.pair,
        batch_settings({}),
        rig.pair.fit,
        progress=done.append,
    )
    assert columns["reason"].tolist() == ["broken.", "empty."] and done == [1, 1]
    assert columns["code"].tolist() == ["refused"] * 2
    assert np.isnan(columns["constant_backlash_deg_std"]).all()


def test_logs_of_unequal_length_share_shapes():
    shapes, first = Shapes(), BatchShape(10_000, 1, 900, 6)
    wide = shapes.holding(first)
    assert wide.over(first) == wide
    assert shapes.holding(BatchShape(9_000, 1, 800, 6)) == wide
    assert shapes.holding(BatchShape(2_000, 1, 200, 6)) != wide
    assert shapes.holding(BatchShape(10_000, 2, 900, 6)).runs == 2
    assert all(n <= rounded_up(n) <= 1.15 * n + 1 for n in range(1, 3000))
    assert (
        logs_at_once(18_000) == 64
        and logs_at_once(18_000, 3) == 8
        and logs_at_once(18_000, 9) == 16
    )
    assert logs_at_once(3_000_000) == 1


def test_codes_have_reasons():
    assert Code.OK.reason == "" and all(code.reason for code in Code if code is not Code.OK)


def test_the_table_is_written_as_csv_and_parquet(tmp_path):
    good = {"log": "a", "code": "ok", "samples_used": 7.0, "e_mm": 0.1 + 0.2, "e_mm_std": 1e-3}
    bad = {"log": "b,c", "code": "empty", "reason": "it has no samples"}
    table = FitTable(joined([table_of([good], ["e_mm"]), table_of([bad], ["e_mm"])]), "rig")
    rows = list(csv.DictReader(StringIO(table.to_csv(tmp_path / "t.csv"))))
    assert float(rows[0]["e_mm"]) == 0.1 + 0.2 and rows[0]["samples_used"] == "7"
    assert rows[1]["log"] == "b,c" and rows[1]["e_mm"] == ""
    assert (tmp_path / "t.csv").read_text() == table.to_csv()
    table.to_parquet(tmp_path / "t.parquet")
    read = pq.read_table(tmp_path / "t.parquet")
    assert read.column("e_mm").to_pylist() == [0.1 + 0.2, None]
    assert len(table) == 2 and table.failures == (("b,c", "empty", "it has no samples"),)
    assert "2, 1 fitted" in str(table) and "b,c: it has no samples" in str(table)


def test_logs_are_prepared_ahead_of_their_turn_in_their_order(monkeypatch):
    """Later logs are ready first here, and few logs are taken before they are needed."""
    monkeypatch.setattr(fit_many_module, "usable_cores", lambda: 3)
    taken = []

    def drawn():
        for number in range(40):
            taken.append(number)
            yield Unread(str(number), LogError("broken."))

    def slow(log: Any) -> Any:
        time.sleep(0.004 if int(log.name) % 3 == 0 else 0.0)
        return log

    seen = []
    for name, found in fit_many_module._in_turn(slow, drawn()):
        assert isinstance(found, Unread) and found.name == name
        assert len(taken) - len(seen) <= 2 * 3 + 1
        seen.append(int(name))
    assert seen == list(range(40))
