"""The machine of the guide on commissioning: LinuxCNC turns a motor, and gears turn the axis.

    python -m tests.guides.machine LOG [--table FILE] [--teeth 40/80 …]
    python -m tests.guides.machine BEFORE AFTER --picture FILE

The first form homes the axis, moves it twice over its travel there and back, and writes LOG: time,
command, angles of the driving shaft and of the axis, with noise of 1″. With a table LinuxCNC
compensates. The second form draws how far the axis is from its command in two such logs.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.control.compensation.linuxcnc import moved
from tests.control.compensation.test_linuxcnc import gears
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.control.compensation.correction import AxisError
from vttig_jax.rig.paper import paper_eccentricities

PACE, EVERY, AFTER = 240.0, 3, 100
"""Speed of the axis, °/s; samples of 1 ms to a row; samples that are kept of a standstill, whose
length depends on how busy the computer is."""


def moves(first: float, last: float) -> list[str]:
    """Approach the begin of the travel in the forward direction, and go over it twice."""
    there = [f"G1 F{60 * PACE:g} A{last:.6f}", "G4 P0.2", f"G1 A{first:.6f}", "G4 P0.2"]
    return [f"G0 A{first - 5:.6f}", "G4 P0.2", f"G0 A{first:.6f}", "G4 P0.2", *there, *there]


def stood(error: AxisError, motor: np.ndarray) -> np.ndarray:
    """Where the axis stands, rad, at angles of the motor that began with a forward motion.

    It rests until a flank pushes it: between motor + E_A and motor + E_B.
    """
    low, high = (motor + error.at(flank, motor) for flank in ("A", "B"))
    place, found = low[0], np.empty_like(motor)
    for k, ends in enumerate(zip(low, high, strict=True)):
        place = found[k] = min(max(place, ends[0]), ends[1])
    return found


def record(asked: argparse.Namespace) -> None:
    """Move the axis with its compensation file, if there is one, and write its log."""
    driving, driven = asked.teeth
    off_centre = dict(zip(("driving_mm", "driven_mm"), asked.eccentricity_mm, strict=True))
    error = gears(driving, driven, replace(paper_eccentricities(), **off_centre))
    error = replace(error, zero=asked.zero_deg * DEG)
    table, (first, last) = asked.table.read_text() if asked.table else "", asked.travel
    with tempfile.TemporaryDirectory() as folder:
        command, motor, speed = (
            one[:, 0] for one in moved(Path(folder), [table], moves(first, last))
        )
    position = stood(error, motor[np.argmin(command) :] * DEG)
    command, motor, speed = (one[-len(position) :] for one in (command, motor, speed))
    moving = np.maximum.accumulate(np.where(speed != 0, np.arange(len(speed)), 0))
    standing = np.arange(len(speed)) - moving
    (begin,) = np.flatnonzero((standing == 1) & (np.abs(command - first) < 1e-6))[:1]
    kept = (np.arange(len(speed)) >= begin) & (standing <= AFTER)
    noise = ARCSEC * np.random.default_rng(len(table)).standard_normal(kept.sum())
    turned = (-1 if asked.motor_reversed else 1) * driven / driving * motor[kept]
    rows = np.stack([command[kept], turned, (position[kept] + noise) / DEG], axis=1)[::EVERY]
    rows = np.column_stack([1e-3 * EVERY * np.arange(len(rows)), rows])
    head = "time_s,command_deg,driving_deg,driven_deg"
    np.savetxt(asked.logs[0], rows, "%.9f", ",", header=head, comments="")


def draw(logs: list[Path], picture: Path) -> None:
    """Draw how far the axis is from its command in each log, by direction."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.2), layout="constrained")
    for log, axes in zip(logs, figure.subplots(1, len(logs), sharey=True), strict=True):
        _, command, _, driven = np.loadtxt(log, delimiter=",", skiprows=1).T
        left, step = 3600 * (driven - command), np.gradient(command)
        ahead, back = step > 0.9 * step.max(), step < 0.9 * step.min()
        level = (left[ahead].mean() + left[back].mean()) / 2
        for own, name in ((ahead, "forward"), (back, "reverse")):
            axes.plot(command[own], left[own] - level, ".", markersize=1.5, label=name)
        axes.set(title=log.stem, xlabel="command, °")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("axis less command, ″")
    figure.axes[0].legend(markerscale=6)
    figure.savefig(picture, dpi=100)


def teeth(text: str) -> tuple[int, int]:
    """Return the teeth of the driving and the driven gear, "40/80"."""
    driving, driven = map(int, text.split("/"))
    return driving, driven


def main() -> None:
    """Run the machine, or draw its logs."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").splitlines()[0],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add, own = parser.add_argument, paper_eccentricities()
    add("logs", nargs="+", type=Path, help="log to write, or two logs to draw")
    add("--table", type=Path, help="compensation file that LinuxCNC loads")
    add("--picture", type=Path, help="picture to draw of two logs")
    add("--teeth", type=teeth, default="40/80", help="teeth of the driving and the driven gear")
    pair = {"nargs": 2, "type": float}
    add(
        "--eccentricity-mm",
        **pair,
        default=(float(own.driving_mm), float(own.driven_mm)),
        metavar=("DRIVING", "DRIVEN"),
        help="of the gears",
    )
    add("--motor-reversed", action="store_true", help="its encoder counts against the axis")
    add("--zero-deg", type=float, default=0.0, help="how far the gears stand further at 0")
    add("--travel", **pair, default=(0.0, 360.0), metavar=("FROM", "TO"), help="of the axis, °")
    asked = parser.parse_args()
    if asked.table is not None and not asked.table.is_file():
        parser.error(f"there is no table {asked.table}")
    if asked.picture is not None:
        draw(asked.logs, asked.picture)
    else:
        record(asked)


if __name__ == "__main__":
    main()
