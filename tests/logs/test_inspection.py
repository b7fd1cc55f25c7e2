import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from tests.logs.profiles import counts, drive, geared, spec, trapezoid
from tests.schemas import load_schema
from vttig_jax.base.files.json_io import dumps
from vttig_jax.cli.main import main
from vttig_jax.logs.checks.sampling import SpeedPlateau, aliased, order_spectrum
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.inspection import inspect_log
from vttig_jax.logs.motion.segments import find_segments


def rig(rate=500.0, pair=None, **motion):
    time, angle, _ = trapezoid(rate=rate, **motion)
    driven, _ = geared(angle)
    return EncoderLog.from_arrays(time, counts(angle) % 65_536, counts(driven), pair=pair or spec())


def flat(report):
    return " ".join(str(report).split())


def checked(report):
    found = json.loads(dumps(report.to_json()))
    jsonschema.validate(found, load_schema("vttig.inspect/1"))
    return found


@pytest.fixture(scope="module")
def report():
    return inspect_log(rig(), spec())


def test_json_keeps_the_schema(report):
    found = checked(report)
    assert found["samples"]["read"] == sum(
        found["samples"][name] for name in ("forward", "backward", "masked")
    )
    driving = found["columns"][1]
    assert driving["role"] == "driving" and driving["modulus"] == 65_536
    assert driving["wraps"] == pytest.approx(2 * 1_890_000 // 65_536, abs=1)
    assert driving["turns"] == pytest.approx(21.0, abs=0.01)
    assert driving["resolution_arcsec"] == pytest.approx(14.4)
    assert found["ratio"]["verdict"] == "agrees"
    assert [p["flank"] for p in found["plateaus"]] == ["A", "B"]
    assert found["support"]["driving_resolved"] and found["support"]["driven_resolved"]


def test_schema_refuses_what_is_wrong(report):
    schema = load_schema("vttig.inspect/1")
    for spoil in ({"schema": "vttig.inspect/2"}, {"extra": 1}, {"plateaus": [{"flank": "C"}]}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**report.to_json(), **spoil}, schema)


def test_spectrum_finds_the_eccentricities(report):
    size = {(s.shaft, s.order, s.flank): s.amplitude_arcsec for s in report.spectrum}
    assert size["driving", 1, "A"] == pytest.approx(72.0, abs=1.0)
    assert size["driven", 1, "B"] == pytest.approx(54.0, abs=1.0)
    assert all(value < 1.0 for (_, order, _), value in size.items() if order > 1)
    assert len(size) == 32


def test_short_logs_tell_fewer_orders_apart_or_none_of_a_shaft():
    log = rig(reversal=1000.0)
    lines, notes = order_spectrum(log, find_segments(log).segments)
    assert 0 < max(line.order for line in lines) < 8
    assert "only orders 1 to" in notes[0]
    log = rig(reversal=540.0)  # the driven shaft turns less than once
    lines, _ = order_spectrum(log, find_segments(log).segments)
    assert {line.shaft for line in lines} == {"driving"}
    assert order_spectrum(log, ()) == ((), ())


def test_orders_shared_by_both_shafts_are_listed_once():
    time, angle, _ = trapezoid(rate=500.0)
    driven = 0.5 * angle + 0.01 * np.sin(angle)
    log = EncoderLog.from_arrays(time, angle, driven, pair=drive("1/2"), unit="deg")
    lines, _ = order_spectrum(log, find_segments(log).segments)
    named = {(line.shaft, line.order) for line in lines}
    assert ("driving", 1) in named and ("driven", 1) in named and ("driven", 2) not in named


def test_commensurate_sampling_is_told():
    frozen = inspect_log(rig(rate=500.0, ripple=0.0))
    (one,) = frozen.commensurate
    assert (one.shaft, round(one.counts_per_sample)) == ("driving", 180)
    assert "a whole number" in flat(frozen)
    free = inspect_log(rig(rate=501.3, ripple=0.0))
    assert free.commensurate == () and "a whole number" not in flat(free)


def test_one_rounding_error_of_a_driving_shaft_moves_the_gap_and_no_order():
    half = np.floor(0.5 * np.concatenate([np.arange(9000), np.arange(9000, 0, -1)]) + 0.3)
    driven = np.floor(0.5625 * half + 50 * np.sin(2 * np.pi * half / 1000))
    time, readings = np.arange(len(half)) / 500.0, (half.astype(int), driven.astype(int))
    encoder = {"counts_per_rev": 1000}
    pair = spec(driving_encoder=encoder, driven_encoder=encoder)
    log = EncoderLog.from_arrays(time, *readings, pair=pair)
    (one,) = inspect_log(log).commensurate
    count_arcsec = 0.5625 * 1296e3 / 1000
    assert one.rounding_arcsec == 0.0 and [std for *_, std in one.offsets] == pytest.approx(
        2 * [count_arcsec / 2 / 12**0.5]
    )
    assert one.gap_arcsec == pytest.approx(2**0.5 * one.offsets[0][2])


def test_aliased_orders():
    slow = inspect_log(rig(rate=70.0), spec())
    named = {a.shaft: (a.order, a.highest) for a in slow.aliased}
    assert named == {"mesh": (1, 1)}
    assert "tooth-mesh order 1" in flat(slow) and "alias" in flat(slow)
    assert inspect_log(rig(rate=70.0)).aliased == ()
    plateau = SpeedPlateau(60.0, "A", 1, 100)
    (found,) = aliased([plateau], 10.0, {"driving": (1.0, range(1, 9))})
    assert (found.order, found.highest) == (5, 8)
    assert aliased([plateau], 10.0, {"driven": (0.5, range(1, 10))}) == ()


@pytest.mark.parametrize(
    ("log", "words"),
    [
        (lambda: rig(reversal=500.0), "the driven shaft turns only"),
        (lambda: rig(reversal=400.0), "neither shaft's eccentricity"),
        (lambda: rig(passes=1), "one direction only (flank A)"),
    ],
)
def test_support(log, words):
    text = flat(inspect_log(log()))
    assert words in text
    assert words not in flat(inspect_log(rig()))


def test_wrong_ratio_is_told_not_raised():
    found = inspect_log(rig(pair=spec(driven_teeth=60)))
    assert found.ratio.verdict == "differs" and "the log shows a ratio of" in flat(found)
    checked(found)


def test_curve_logs():
    time = np.arange(3000) / 10.0
    curve = 5 * np.sin(np.radians(20 * time)) + 0.01 * time
    log = EncoderLog.from_arrays(
        time, 20 * time, pair=drive("1/225"), unit="deg", transmission_error=curve
    )
    found = inspect_log(log)
    checked(found)
    (first,) = [s for s in found.spectrum if s.order == 1]
    assert first.shaft == "driving" and first.amplitude_arcsec == pytest.approx(5.0, abs=0.01)


def test_what_spoils_a_fit_is_noted_first(report):
    """A ratio that the log doubts, then a slip, then sampling and coverage, then the rest."""
    doubted = replace(report.ratio, seen=0.5625 + 1e-4, std=2e-5)
    slip, usual = "the transmission error steps", "driving: wraps"
    made = replace(report, ratio=doubted, notes=(slip, usual), problems=1)
    text = flat(made)
    places = [text.index(part) for part in ("5.0 standard errors above", slip, usual)]
    assert places == sorted(places)
    assert "standard errors above" not in flat(report)


@pytest.mark.parametrize("options", [[], ["--ratio", "16:9"], ["--ratio", "16:9", "-v"]])
def test_the_text_shows_what_the_object_holds(tmp_path, capsys, options):
    """Columns, commands and notes; the columns of a large matrix share one row."""
    time, angle, _ = trapezoid(rate=50.0, reversal=1080.0)
    force = {f"force({k},:)": f"{k}" for k in range(1, 41)}
    names = ["time [s]", "p [deg]", "q [deg]", *force]
    rows = [
        [f"{t:.3f}", f"{a:.4f}", f"{0.5625 * a:.4f}", *force.values()]
        for t, a in zip(time, angle, strict=True)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(";".join(row) for row in [names, *rows]))
    assert main(["inspect", str(path), *options]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert main(["inspect", str(path), "--json", *options]) == 0
    found = json.loads(capsys.readouterr().out)
    shown = [one["name"] for one in found["columns"] if "force" not in one["name"]]
    commands = [found.get("fit_command"), *(one["command"] for one in found.get("proposals", []))]
    for part in (*shown, *found["notes"], *filter(None, commands)):
        assert " ".join(part.split()) in text, part
    assert options or ("force(1…40,:)" in text and text.count("force") == 1 and len(commands) == 3)
