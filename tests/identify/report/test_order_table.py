"""Which orders count beside a line that is no order."""

import json
from dataclasses import replace

import jsonschema
import msgspec
import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.base.files.json_io import dumps, load_schema
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report.checks import ResidualLine
from vttig_jax.identify.report.order_table import Order, judged_orders
from vttig_jax.identify.store import fit_arrays, read_fit

PAIR = drive("9/16", orders=(1, 2, 3))
ORDER = Order("driving", 3, "A", amplitude_arcsec=2.0, std_arcsec=0.1, phase_deg=0.0)
LINE = ResidualLine(
    log=0,
    flank=None,
    cycles_per_rev=3.09,
    cycles_std=1e-3,
    amplitude_arcsec=30.0,
    amplitude_std_arcsec=0.1,
    phase_deg=0.0,
    false_alarm=1e-9,
)


def _fitted(cycles: float) -> Fit:
    """A line of 30″ in passes of 20 turns; white noise lets it leak into the orders nearby."""

    def error(angle, _):
        first = 20 * np.sin(angle + 0.3) + 30 * np.sin(angle * 9 / 16 + 1)
        return first + 30 * np.sin(cycles * angle)

    log = drive_log(PAIR, there_and_back([60, 60, 60], 20), gap=level(200.0), error=error)
    return fit(log, PAIR, delay="off", noise="white", lines="report")


@pytest.fixture(scope="module")
def beside() -> Fit:
    return _fitted(3.09)


def _significant(orders: tuple[Order, ...]) -> set[bool]:
    return {one.significant for one in orders if (one.shaft, one.order) == ("driving", 3)}


def test_leakage_of_a_line_is_no_order(beside):
    assert any(abs(line.cycles_per_rev - 3.09) < 0.01 for line in beside.checks.lines)
    assert _significant(beside.orders) == {True}
    assert _significant(beside.judged_orders()) == {False}


def test_a_true_order_counts():
    result = _fitted(3.0)
    assert _significant(result.judged_orders()) == {True}


def test_the_record_keeps_the_judgement(beside, tmp_path):
    record = beside.to_json()
    jsonschema.validate(record, load_schema("vttig.fit/1"))
    (tmp_path / "fit.json").write_text(dumps(record), encoding="utf-8")
    np.savez(tmp_path / "summary.npz", allow_pickle=False, **fit_arrays(beside))
    written = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))["orders"]
    kept = {(o["shaft"], o["order"], o["flank"]): o["significant"] for o in written}
    assert not kept["driving", 3, "A"] and kept["driving", 1, "A"]
    again = read_fit(tmp_path, PAIR)
    assert {(o.shaft, o.order, o.flank): o.significant for o in again.orders} == kept
    assert again.to_json() == record


def test_the_schema_requires_the_judgement(beside):
    record = beside.to_json()
    del record["orders"][0]["significant"]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(record, load_schema("vttig.fit/1"))


@pytest.mark.smoke
@pytest.mark.parametrize(
    ("order", "line", "turns", "counts"),
    [
        (ORDER, LINE, 20.0, False),
        (ORDER, LINE, 100.0, True),  # nine resolutions away
        (ORDER, None, 20.0, True),
        (replace(ORDER, amplitude_arcsec=40.0), LINE, 20.0, True),  # larger than the line
        (replace(ORDER, shaft="mesh"), LINE, 20.0, True),
        (replace(ORDER, shaft="driven"), LINE, 20.0, True),  # at 3 · 9/16 cycles
        (replace(ORDER, significant=False), None, 20.0, False),
    ],
)
def test_only_a_larger_line_nearby_takes_an_order(order, line, turns, counts):
    lines = [] if line is None else [line]
    (judged,) = judged_orders([order], lines, 9 / 16, turns)
    assert judged.significant == counts


@pytest.mark.smoke
def test_a_line_of_one_flank_takes_no_order_of_the_other():
    line = msgspec.structs.replace(LINE, flank="B")
    (judged,) = judged_orders([ORDER], [line], 9 / 16, 20.0)
    assert judged.significant


@pytest.mark.parametrize(("noise_arcsec", "counts"), [(0.3, True), (300.0, False)])
def test_an_order_counts_above_three_of_its_standard_errors(noise_arcsec, counts):
    """The size alone says nothing: 1″ in little noise is an order, and 8″ in much noise is none."""

    def error(angle, _):
        first = 20 * np.sin(angle + 0.3) + 30 * np.sin(angle * 9 / 16 + 1)
        return first + (1.0 if counts else 8.0) * np.sin(2 * angle)

    motion = there_and_back([60, 60], 20)
    log = drive_log(PAIR, motion, gap=level(200.0), error=error, noise_arcsec=noise_arcsec)
    orders = fit(log, PAIR, delay="off", noise="white", drift_order=0, lines="report").orders
    found = [one for one in orders if (one.shaft, one.order) == ("driving", 2)]
    assert len(found) == 2
    for one in found:
        assert one.significant is counts
        assert (one.amplitude_arcsec < 3.0) is counts
        assert (one.amplitude_arcsec > 3 * one.std_arcsec) is counts
