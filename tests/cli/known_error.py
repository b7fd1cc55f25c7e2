"""Logs made by plain trigonometry from a known transmission error of each flank."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.cli.commands import fit_into

GAP_ARCSEC = 90.0
TURNS = 8
"""Driving turns of a log in each direction: four hunting periods of the drive 1 : 2."""


def error_arcsec(flank: str, driving: np.ndarray, ratio: float = 0.5) -> np.ndarray:
    """True transmission error; flank B has another phase, and stands above flank A by the gap."""
    on_b = flank == "B"
    return (
        30.0 * np.sin(driving + (0.9 if on_b else 0.3))
        + 6.0 * np.sin(3 * driving + 2.0)
        + 50.0 * np.sin(ratio * driving + 1.1)
        + (GAP_ARCSEC if on_b else 0.0)
    )


def worm_arcsec(flank: str, driving: np.ndarray) -> np.ndarray:
    """True transmission error of a worm, whose wheel has none."""
    return error_arcsec(flank, driving, 0.0)


def fitted(
    folder: Path,
    error: Callable[[str, np.ndarray], np.ndarray],
    *options: str,
    ratio: float = 0.5,
    slip: float = 1.0,
    back: bool = True,
) -> Path:
    """Run folder with the fit of a log of `error` with noise of 1″, at 60 rpm, 50 Hz.

    The driven shaft turns `slip` times as fast as the ratio of the pair file says.
    """
    folder.mkdir()
    there = [0, 60, 60, 0], [0, 0.5, 0.5 + TURNS, 1 + TURNS]
    speeds, times = np.array(there[0] + [0, -60, -60, 0]), np.array(there[1] + [2, 2.5, 10.5, 11])
    times[4:] += times[3] - 1.0
    if not back:
        speeds, times = speeds[:4], times[:4]
    time = np.arange(0, times[-1], 0.02)
    fine = np.linspace(0, times[-1], 200_001)
    speed = np.interp(fine, times, speeds) * 2 * np.pi / 60
    turned = np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2) * fine[1]])
    driving = np.interp(time, fine, turned)
    forward = np.interp(time, times, speeds) >= 0
    te = np.where(forward, error("A", driving), error("B", driving))
    te += np.random.default_rng(0).standard_normal(len(time))
    driven_deg = np.degrees(slip * ratio * driving) + (te - te[0]) / 3600
    table = np.stack([time, np.degrees(driving), driven_deg], axis=1)
    head = "time_s,driving_deg,driven_deg"
    np.savetxt(folder / "log.csv", table, "%.9f", ",", header=head, comments="")
    (folder / "pair.toml").write_text(
        f'name = "drive"\n[drive]\nratio = "1/{1 / ratio:.0f}"\n'
        "[fit]\ndriving_orders = [1, 2, 3]\ndriven_orders = [1, 2]\n"
    )
    return fit_into(folder / "run", folder / "log.csv", folder / "pair.toml", *options)
