"""Worm drives of telescopes: their first orders, and their period found blind."""

import json
from pathlib import Path

import numpy as np
import pytest

import vttig_jax
from tests.test_fits import FITS
from vttig_jax.base.units import ARCSEC
from vttig_jax.logs.lines.search import Stretch, find_lines
from vttig_jax.runs.error_table import error_table

WORM = FITS / "worm_mount"


@pytest.mark.portable
@pytest.mark.parametrize(
    ("name", "known", "within"),
    [("ap_gt1100", 3.77, 0.15), ("ap_24turns", 1.6, 0.3), ("cge", 7.9, 0.8)],
)
def test_worm_drives(data_dir: Path, name: str, known: float, within: float):
    pair = vttig_jax.load_pair(WORM / ("cge.toml" if name == "cge" else "pair.toml"))
    log = vttig_jax.read_log(data_dir / "worm_mount" / f"{name}.csv", pair)
    fit = vttig_jax.fit(log, pair, ratio_within=0)
    first = fit.parameters["driving_amplitude_arcsec"]
    assert first.value == pytest.approx(known, abs=within)
    assert first.std is not None and 0 < first.std < within
    assert first.low95 is not None and first.high95 is not None
    assert first.low95 < known < first.high95
    kept = json.loads((WORM / name / "fit.json").read_text(encoding="utf-8"))
    assert kept["parameters"]["driving_amplitude_arcsec"]["value"] == pytest.approx(first.value)
    assert fit.parameters["driven_amplitude_arcsec"].determined is False


def test_a_driven_order_that_is_not_told_is_not_in_the_error(data_dir: Path):
    """A ninth of a turn of the worm wheel: the fit and its draws have the error of 24 turns."""
    log = vttig_jax.read_log(data_dir / "worm_mount" / "ap_24turns.csv", ratio="225:1")
    fit = vttig_jax.fit(log)
    table, _, _ = error_table(fit, vttig_jax.sample(fit, steps=60), 2.0, 225.0)
    size, known = table["transmission_error"]["A"], fit.flank_errors["A"]
    assert size["turns"] == pytest.approx(known.turns, abs=0.1)
    assert size["peak_to_peak_deg"] == pytest.approx(known.peak_to_peak_deg, rel=0.05)
    draws = size["peak_to_peak_draws_deg"]
    assert draws["low95"] < size["peak_to_peak_deg"] < draws["high95"] < 1.3 * draws["low95"]
    assert fit.conditional_on == ("flank_A_only",)


def test_worm_period_found_blind(data_dir: Path):
    """Nothing is given but time and error; the period is that of a sidereal day over 225."""
    periods = {}
    for name in ("ap_gt1100", "ap_24turns"):
        path = data_dir / "worm_mount" / f"{name}.csv"
        time, _, error = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
        drift = np.vander((time - time.mean()) / np.ptp(time), 3)
        found = find_lines([Stretch(2 * np.pi * time, error * ARCSEC, drift)], highest=0.02)
        found = sorted(found, key=lambda line: -line.amplitude_arcsec)
        periods[name] = [1 / line.cycles_per_rev for line in found]
    assert periods["ap_gt1100"][0] == pytest.approx(383.0, rel=0.003)
    assert 2 * periods["ap_gt1100"][1] == pytest.approx(383.0, rel=0.003)
    assert periods["ap_24turns"][0] == pytest.approx(383.0, rel=0.005)
    assert 5 * periods["ap_24turns"][1] == pytest.approx(383.0, rel=0.001)
    assert pytest.approx(383.0, rel=0.0002) == 86164.1 / 225


def test_worm_readme_gives_the_fitted_orders():
    readme = (WORM / "README.md").read_text(encoding="utf-8")
    strong = {}
    for name, many in (("ap_gt1100", 2), ("ap_24turns", 1), ("cge", 1)):
        orders = json.loads((WORM / name / "fit.json").read_text(encoding="utf-8"))["orders"]
        for order in orders[:many]:
            assert f"{order['amplitude_arcsec']:.3f}″ ± {order['std_arcsec']:.3f}″" in readme
        strong[name] = [o["order"] for o in orders if o["significant"]]
    assert strong["ap_gt1100"][:2] == strong["cge"][:2] == [1, 2]
    assert [round(order, 2) for order in strong["ap_24turns"]] == [1, 2, 3, 4, 5, 6, 7.22, 8]
    assert [round(order, 2) for order in strong["cge"][2:]] == [2.66, 6.66]
