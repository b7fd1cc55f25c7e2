"""Three axes of a robot, two logs, fitted in four ways: the tables of README.md.

    python fits/kuka_kr300/tables.py

Angles are arcseconds of the output.
"""

from functools import cache
from pathlib import Path
from typing import Any

import vttig_jax
from vttig_jax.base.files.text_tables import text_table
from vttig_jax.identify.result import Fit
from vttig_jax.model.parameter import Parameter

vttig_jax.enable_x64()

HERE = Path(__file__).resolve().parent
LOGS = HERE.parents[2] / "shared" / "data" / "kuka_kr300"

PLAIN, REPORTED, OFF, EXACT = "no options", "--lines report", "--delay off", "--ratio-within 0"
WAYS: dict[str, dict[str, Any]] = {
    PLAIN: {},
    OFF: {"delay": "off"},
    REPORTED: {"lines": "report"},
    EXACT: {"ratio_within": 0.0},
}
"""Options of the command, and what they are in Python."""

_HEADERS = {
    PLAIN: [
        "delay [ms]",
        "residual",
        "B above A",
        "motor order 1",
        "strongest line",
        "ratio [ppm]",
    ],
    REPORTED: ["delay [ms]", "residual", "B above A", "motor order 1", "strongest line"],
    OFF: ["residual", "B above A"],
    EXACT: ["delay [ms]", "residual", "B above A"],
}


@cache
def fitted(axis: int, logs: str, way: str = PLAIN) -> Fit:
    """Fit one axis to log "A" or "B", or to both, "AB", in one fit."""
    pair = vttig_jax.load_pair(HERE / f"axis{axis}.toml")
    read = [vttig_jax.read_log(LOGS / f"kr300_{name}_axes123.csv", pair) for name in logs]
    return vttig_jax.fit(read, pair, **WAYS[way])


def row(axis: int, logs: str, way: str) -> list[str]:
    """Cells of one fit in the table of `way`."""
    fit = fitted(axis, logs, way)
    gap = fit.checks.gap_over_angles_covered
    cells = {
        "delay [ms]": _with_std(fit.parameters["delay_s"], 1e3, ".2f"),
        "residual": f"{3600 * fit.residual_rms_deg:.1f}",
        "B above A": f"{3600 * (gap.value or 0.0):+.1f} ± {3600 * (gap.std or 0.0):.1f}",
        "motor order 1": _limit(fit.parameters["driving_amplitude_arcsec"]),
        "strongest line": _line(fit),
    }
    for found in fit.regressors:
        if found.name == "ratio":
            cells["ratio [ppm]"] = _with_std(found, 1e6 / float(fit.pair.ratio), "+.0f", 1e6)
    return [str(axis), " and ".join(logs), *(cells[name] for name in _HEADERS[way])]


def _with_std(found: Parameter, scale: float, places: str, less: float = 0.0) -> str:
    if found.value is None or found.std is None:
        return "–"
    value = format(scale * found.value - less, places)
    return f"{value} ± {format(scale * found.std, places.lstrip('+'))}"


def _limit(found: Parameter) -> str:
    return f"< {found.upper95:.1f}" if found.upper95 is not None else f"{found.value:.1f}"


def _line(fit: Fit) -> str:
    """The strongest fractional order or line that is left in the residual."""
    joined = [(o.amplitude_arcsec, o.order) for o in fit.orders if o.order != int(o.order)]
    lines = [(line.amplitude_arcsec, line.cycles_per_rev) for line in fit.checks.lines]
    amplitude, cycles = max([*joined, *lines], default=(0.0, 0.0))
    return f"{amplitude:.1f} at {cycles:.2f}" if amplitude else "none"


def table(way: str) -> str:
    """All axes and logs fitted in one way."""
    logs = ("A", "B", "AB") if way in (PLAIN, REPORTED) else ("A", "B")
    rows = [row(axis, each, way) for axis in (1, 2, 3) for each in logs]
    return f"{way}\n" + text_table(rows, ["axis", "log", *_HEADERS[way]])


if __name__ == "__main__":
    print("\n\n".join(table(way) for way in WAYS))
