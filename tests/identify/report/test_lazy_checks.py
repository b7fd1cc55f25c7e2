"""Costly checks are carried out when they are read, once, and without the samples of the log."""

import gc
import json
import weakref
from dataclasses import replace

import msgspec
import pytest

from vttig_jax.base.files.json_io import dumps
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report import check_records as assemble
from vttig_jax.identify.report.checks import Checks
from vttig_jax.identify.report.record import Later


@pytest.fixture
def searched(monkeypatch) -> list[int]:
    """Number of runs of rows in every search for lines."""
    calls: list[int] = []
    search = assemble.lines_left

    def counted(rows, *args, **kwargs):
        calls.append(len(rows))
        return search(rows, *args, **kwargs)

    monkeypatch.setattr(assemble, "lines_left", counted)
    return calls


def test_lines_are_searched_on_reading_and_once(searched, quick_rig, quick_log):
    checks = fit(quick_log, quick_rig.pair, lines="report").checks
    assert checks.solver_steps > 0 and len(checks.ratio) == 1 and searched == []
    first = list(checks.lines)
    assert searched == [1] and list(checks.lines) == first and searched == [1]


def test_the_record_and_the_report_have_them(searched, quick_rig, quick_log):
    result = fit(quick_log, quick_rig.pair)
    record = result.to_json()["checks"]
    assert searched == [1] and list(record) == list(Checks.__struct_fields__)
    assert record == json.loads(dumps(record))
    str(fit(quick_log, quick_rig.pair))
    assert searched == [1, 1]


def test_the_record_is_read_back(quick_rig, quick_log):
    checks = fit(quick_log, quick_rig.pair).checks
    again = msgspec.convert(checks.to_json(), Checks)
    assert again.to_json() == checks.to_json()
    assert (again.reversals, again.whiteness) == (checks.reversals, checks.whiteness)
    assert list(again.passes) == list(checks.passes)


def test_the_samples_are_not_kept(quick_rig):
    log = replace(quick_rig).log(3)
    seen = weakref.ref(log)
    result = fit(log, quick_rig.pair)
    del log
    gc.collect()
    assert seen() is None
    assert not result.checks.lines


def test_a_check_that_fails_is_tried_again():
    answers = iter([ZeroDivisionError, 5])

    def compute():
        answer = next(answers)
        if answer is ZeroDivisionError:
            raise ZeroDivisionError
        return [answer]

    later = Later(compute)
    with pytest.raises(ZeroDivisionError):
        len(later)
    assert len(later) == 1 and list(later) == [5] and later[:1] == [5]
