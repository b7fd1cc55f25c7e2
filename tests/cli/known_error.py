"""Logs made by plain trigonometry from a known transmission error of each flank."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.cli.commands import fit_into, write_log
from tests.identify.drives import drive, drive_log, there_and_back

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
    durations, rpms = there_and_back([60], TURNS, ramp_s=0.5)
    kept = len(durations) if back else 5
    log = drive_log(
        drive(f"1/{1 / ratio:.0f}"),
        (durations[:kept], rpms[:kept]),
        gap=lambda angle, _: error("B", angle) - error("A", angle),
        error=lambda angle, _: error("A", angle),
        noise_arcsec=1.0,
        rate_hz=50.0,
        ratio=slip * ratio,
    )
    write_log(folder / "log.csv", log)
    (folder / "pair.toml").write_text(
        f'name = "drive"\n[drive]\nratio = "1/{1 / ratio:.0f}"\n'
        "[fit]\ndriving_orders = [1, 2, 3]\ndriven_orders = [1, 2]\n"
    )
    return fit_into(folder / "run", folder / "log.csv", folder / "pair.toml", *options)
