"""Costly checks are carried out when they are read, once, and without the samples of the log."""

import gc
import weakref
from dataclasses import replace

import pytest

from vttig_jax.identify import build_result as assemble
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report.lazy_checks import Checks


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
    result = fit(quick_log, quick_rig.pair)
    assert "lines" in result.checks and searched == []
    first = result.checks["lines"]
    assert searched == [1] and result.checks["lines"] is first and searched == [1]


def test_the_record_and_the_report_have_them(searched, quick_rig, quick_log):
    result = fit(quick_log, quick_rig.pair)
    record = result.to_json()["checks"]
    assert searched == [1] and {"lines", "halves", "passes"} <= set(record)
    assert record == dict(result.checks) and type(record) is dict
    str(fit(quick_log, quick_rig.pair))
    assert searched == [1, 1]


def test_the_samples_are_not_kept(quick_rig):
    log = replace(quick_rig).log(3)
    seen = weakref.ref(log)
    result = fit(log, quick_rig.pair)
    del log
    gc.collect()
    assert seen() is None
    assert result.checks["lines"] == []


def test_a_check_that_fails_is_tried_again():
    answers = iter([ZeroDivisionError, 5])

    def later():
        answer = next(answers)
        if answer is ZeroDivisionError:
            raise ZeroDivisionError
        return answer

    checks = Checks({"a": 1}, {"b": later})
    assert len(checks) == 2 and "lines" not in repr(checks) and "b" in repr(checks)
    with pytest.raises(ZeroDivisionError):
        checks["b"]
    assert checks["b"] == 5 and dict(checks) == {"a": 1, "b": 5}
    with pytest.raises(KeyError):
        checks["c"]
