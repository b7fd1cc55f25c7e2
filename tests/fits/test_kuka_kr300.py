"""Robot axes: a delay that looks like backlash, what stays undetermined, and a line at 3.09."""

import itertools
import re
from fractions import Fraction
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import vttig_jax
from tests.test_fits import FITS, script

KUKA = FITS / "kuka_kr300"


@pytest.fixture(scope="module")
def kuka(data_dir: Path) -> ModuleType:
    """The script `fits/kuka_kr300/tables.py`; its fits of 2 s are shared by the tests below."""
    module = script("kuka_kr300/tables")
    assert data_dir / "kuka_kr300" == module.LOGS
    return module


KNOWN_DELAY_S = {1: 2.95e-3, 2: 2.84e-3, 3: 2.71e-3}
"""By plain least squares, which takes a part of the friction for a lead."""

LOGS = [*itertools.product((1, 2, 3), "AB")]
"""Axis and log."""


def test_a_line_has_one_frequency_and_one_amplitude(kuka: ModuleType):
    fit = kuka.fitted(3, "B")
    joined = [one for one in fit.checks.lines if one.joined]
    assert joined
    for line in joined:
        own = [one for one in fit.orders if one.order == line.cycles_per_rev]
        assert [one.flank for one in own] == ["A", "B"]
        both = [one.amplitude_arcsec * np.exp(1j * np.radians(one.phase_deg)) for one in own]
        assert line.amplitude_arcsec == pytest.approx(abs(np.mean(both)))
        assert line.cycles_std > 0


def test_kuka_delay_residual_and_what_stays_undetermined(kuka):
    for axis, log in LOGS:
        fit = kuka.fitted(axis, log)
        assert fit.value("delay_s") == pytest.approx(3.03e-3, abs=0.08e-3)  # one controller
        gap = fit.checks.gap_over_angles_covered
        assert gap.determined and gap.value is not None and gap.std is not None
        assert abs(gap.value) < 3 * gap.std and gap.value < 7 / 3600  # nothing that a gap could be
        assert 3600 * fit.residual_rms_deg <= (7.6 if axis == 2 else 5.5)
        output, motor = (fit.parameters[f"{s}_amplitude_arcsec"] for s in ("driven", "driving"))
        assert not output.determined and output.reason
        assert not fit.parameters["constant_backlash_deg"].determined
        assert motor.determined and not motor.significant
        assert motor.upper95 is not None and motor.upper95 < 2.4
        assert fit.parameters["driving_phase_deg"].value is None
        assert all(abs(line.cycles_per_rev - 1) > 0.1 for line in fit.checks.lines)


@pytest.mark.parametrize("log", "AB")
def test_kuka_line_of_axis_2_takes_no_order_with_it(kuka: ModuleType, log: str):
    """The leakage of 3.087 into the third order of the motor, up to 5.7″ without it."""
    fit = kuka.fitted(2, log)
    assert any(line.joined and abs(line.cycles_per_rev - 3.09) < 0.003 for line in fit.checks.lines)
    third = [one for one in fit.orders if (one.shaft, one.order) == ("driving", 3)]
    assert third and all(one.amplitude_arcsec < 1.5 for one in third)


@pytest.mark.slow
def test_kuka_values_do_not_hang_on_the_lines(kuka):
    for axis, log in LOGS:
        with_lines, without = kuka.fitted(axis, log), kuka.fitted(axis, log, kuka.REPORTED)
        assert not any(line.joined for line in without.checks.lines)
        for name in ("delay_s", "driving_amplitude_arcsec"):
            one, other = with_lines.parameters[name], without.parameters[name]
            assert abs(one.value - other.value) < 1.96 * other.std
            assert one.significant == other.significant


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_kuka_without_delay_looks_like_backlash(kuka: ModuleType, axis: int):
    """A gap that grows with the speed, of which the fit warns, and that the jumps do not show."""
    naive, fit = kuka.fitted(axis, "B", kuka.OFF), kuka.fitted(axis, "B")
    gap = naive.checks.gap_over_angles_covered
    assert gap.low95 is not None and gap.value is not None
    assert gap.low95 > 0 and 3600 * gap.value > 100
    assert any(one.slug == "gap-of-speed" for one in naive.findings)
    assert naive.residual_rms_deg > fit.residual_rms_deg
    assert max(jump.jump_deg for jump in naive.checks.reversals) < 0.3 * gap.value


def kuka_channels(data_dir: Path, axis: int, log: str, delay_s: float) -> dict[str, np.ndarray]:
    """Motor angle in revolutions, TE in arcsec and five regressors, from the file alone."""
    path = data_dir / "kuka_kr300" / f"kr300_{log}_axes123.csv"
    table = np.genfromtxt(path, delimiter=",", names=True)
    time, motor = table["t_s"], table[f"mot{axis}_deg"]
    ratio = {1: 7 / 1798, 2: 7 / 1872, 3: 3 / 757}[axis]
    late = np.interp(time - delay_s, time, motor)
    speed = np.gradient(motor, time)
    columns = [np.ones_like(time), speed, table[f"tau{axis}_Nm"], motor, np.gradient(speed, time)]
    return {
        "turns": late / ratio / 360.0,
        "error": 3600 * (table[f"se{axis}_deg"] - late),
        "columns": np.stack(columns, axis=1),
        "share": np.abs(speed) / np.abs(speed).max(),
    }


def ripple(channels: dict[str, np.ndarray], slowest: float) -> tuple[float, float]:
    """Cycles a turn and amplitude of the sinusoid that helps plain least squares most near 3.1."""
    used = channels["share"] > slowest
    error, found = channels["error"][used], []
    for cycles in np.arange(3.0, 3.2, 0.002):
        phase = 2 * np.pi * cycles * channels["turns"]
        pair = np.stack([np.cos(phase), np.sin(phase)], axis=1)
        design = np.concatenate([channels["columns"], pair], axis=1)[used]
        coefficients, *_ = np.linalg.lstsq(design, error, rcond=None)
        left = np.sum((error - design @ coefficients) ** 2)
        found.append((left, cycles, np.hypot(*coefficients[-2:])))
    return min(found)[1:]


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_kuka_delay_by_plain_least_squares(data_dir: Path, axis: int):
    channels = kuka_channels(data_dir, axis, "A", 0.0)
    coefficients, *_ = np.linalg.lstsq(channels["columns"], channels["error"], rcond=None)
    assert -coefficients[1] / 3600 == pytest.approx(KNOWN_DELAY_S[axis], abs=5e-6)


def test_kuka_delay_by_whitened_least_squares(kuka, data_dir):
    """All axes show one delay to plain equations whose errors remember nine tenths of the last."""
    for axis, log in LOGS:
        channels = kuka_channels(data_dir, axis, log, 0.0)
        used = (channels["share"] > 0.1)[1:] & (channels["share"] > 0.1)[:-1]
        cycles = {1: [2.0, 3.95], 2: [1.545, 3.09, 4.635], 3: [1.344, 2.688, 5.376]}[axis]
        phase = 2 * np.pi * np.outer(channels["turns"], cycles)
        design = np.concatenate([channels["columns"], np.cos(phase), np.sin(phase)], axis=1)
        design, error = (x[1:] - 0.9 * x[:-1] for x in (design, channels["error"]))
        coefficients, *_ = np.linalg.lstsq(design[used], error[used], rcond=None)
        assert -coefficients[1] / 3600 == pytest.approx(3.05e-3, abs=0.12e-3)
        assert kuka.fitted(axis, log).value("delay_s") == pytest.approx(
            -coefficients[1] / 3600, abs=0.15e-3
        )


@pytest.mark.parametrize(("slowest", "least", "most"), [(0.1, 242, 337), (0.0, 150, 239)])
def test_kuka_raw_gap_grows_with_speed(data_dir: Path, slowest: float, least: int, most: int):
    gaps = []
    for axis, log in LOGS:
        channels = kuka_channels(data_dir, axis, log, 0.0)
        used, speed = channels["share"] > slowest, channels["columns"][:, 1]
        back, forth = (channels["error"][used & (sign * speed > 0)].mean() for sign in (-1, 1))
        gaps.append(back - forth)
    assert (round(min(gaps)), round(max(gaps))) == (least, most)


@pytest.mark.parametrize(("log", "known"), [("A", (16.2, 14.2, 19.3)), ("B", (17.5, 14.4, 18.3))])
def test_kuka_ripple_of_axis_2(kuka: ModuleType, data_dir: Path, log: str, known: tuple):
    """Amplitudes above a tenth and above half of the top speed, and everywhere."""
    channels = kuka_channels(data_dir, 2, log, 0.00293)
    line = kuka.fitted(2, log, kuka.REPORTED).checks.lines[0]
    cycles, amplitude = ripple(channels, 0.1)
    assert line.cycles_per_rev == pytest.approx(cycles, abs=0.004)
    assert line.amplitude_arcsec == pytest.approx(amplitude, abs=1.5)
    assert line.false_alarm < 1e-60
    found = [ripple(channels, slowest)[1] for slowest in (0.1, 0.5, -1.0)]
    assert found == pytest.approx(known, abs=0.06)


def test_ripple_is_recovered():
    turns = np.linspace(0.0, 20.0, 2000)
    channels = {
        "turns": turns,
        "error": 5.0 + 12.0 * np.sin(2 * np.pi * 3.1 * turns + 1.0),
        "columns": np.ones((2000, 1)),
        "share": np.ones(2000),
    }
    cycles, amplitude = ripple(channels, 0.1)
    assert cycles == pytest.approx(3.1, abs=1e-9) and amplitude == pytest.approx(12.0)
    elsewhere = 12.0 * np.sin(2 * np.pi * 4.1 * turns)
    assert ripple(channels | {"error": elsewhere}, 0.1)[1] < 1.0


ROWS = [(axis, "A", "PLAIN") for axis in (1, 2, 3)]
"""Rows of the README's tables that each test run fits anew: all of them would take a minute."""
OTHERS = [(2, "AB", "PLAIN"), (2, "A", "EXACT"), *((axis, "A", "OFF") for axis in (1, 2, 3))]
OTHERS += [(axis, log, "PLAIN") for axis, log in LOGS if log != "A"]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "fitted", [ROWS, pytest.param(OTHERS, marks=pytest.mark.slow)], ids=["quick", "slow"]
)
def test_kuka_readme_has_the_rows_of_the_script(kuka: ModuleType, fitted: list):
    readme = (KUKA / "README.md").read_text(encoding="utf-8")
    printed = readme.split("    python fits/kuka_kr300/tables.py\n")[1]
    printed = printed.split("```text\n")[1].split("\n```")[0]
    tables = {table.splitlines()[0]: table.splitlines()[2:] for table in printed.split("\n\n")}
    assert set(tables) == set(kuka.WAYS)
    for axis, log, way in fitted:
        name = getattr(kuka, way)
        rows = {tuple(re.split(r"\s{2,}", line)) for line in tables[name]}
        assert tuple(kuka.row(axis, log, name)) in rows
        assert ("9", *kuka.row(axis, log, name)[1:]) not in rows


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_kuka_pair_files(axis: int):
    pair = vttig_jax.load_pair(KUKA / f"axis{axis}.toml")
    assert isinstance(pair, vttig_jax.Drive)
    assert pair.ratio == {1: Fraction(7, 1798), 2: Fraction(7, 1872), 3: Fraction(3, 757)}[axis]
    assert pair.ratio * Fraction(pair.log.driving_scale) == 1
