"""The machine of the guide on commissioning: LinuxCNC turns a motor, and gears turn the axis.

    python -m tests.guides.machine LOG [--table FILE]
    python -m tests.guides.machine BEFORE AFTER --picture FILE

The first form homes the axis, turns it twice there and back, and writes LOG: time, command, angles
of the driving shaft and of the axis, with noise of 1″. With a table LinuxCNC compensates. The
second form draws how far the axis is from its command in two such logs.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from tests.control.compensation.linuxcnc import moved
from tests.control.compensation.test_linuxcnc import gears
from vttig_jax.base.units import ARCSEC, DEG

PACE, EVERY, AFTER = 240.0, 3, 100
"""Speed of the axis, °/s; samples of 1 ms to a row; samples that are kept of a standstill, whose
length depends on how busy the computer is."""

_TURN = [f"G1 F{60 * PACE:g} A360", "G4 P0.2", "G1 A0", "G4 P0.2"]
MOVES = ["G0 A-5", "G4 P0.2", "G0 A0", "G4 P0.2", *_TURN, *_TURN]


def stood(motor: np.ndarray) -> np.ndarray:
    """Where the axis stands, rad, at angles of the motor that began with a forward motion.

    It rests until a flank pushes it: between motor + E_A and motor + E_B.
    """
    error = gears(40, 80)
    low, high = (motor + error.at(flank, motor) for flank in ("A", "B"))
    place, found = low[0], np.empty_like(motor)
    for k, ends in enumerate(zip(low, high, strict=True)):
        place = found[k] = min(max(place, ends[0]), ends[1])
    return found


def record(log: Path, table: str) -> None:
    """Move the axis with a compensation file, none if empty, and write its log."""
    with tempfile.TemporaryDirectory() as folder:
        command, motor, speed = (one[:, 0] for one in moved(Path(folder), [table], MOVES))
    position = stood(motor[np.argmin(command) :] * DEG)
    command, motor, speed = (one[-len(position) :] for one in (command, motor, speed))
    moving = np.maximum.accumulate(np.where(speed != 0, np.arange(len(speed)), 0))
    standing = np.arange(len(speed)) - moving
    (begin,) = np.flatnonzero((standing == 1) & (command == 0.0))[:1]
    kept = (np.arange(len(speed)) >= begin) & (standing <= AFTER)
    noise = ARCSEC * np.random.default_rng(len(table)).standard_normal(kept.sum())
    rows = np.stack([command[kept], 2 * motor[kept], (position[kept] + noise) / DEG], axis=1)[
        ::EVERY
    ]
    rows = np.column_stack([1e-3 * EVERY * np.arange(len(rows)), rows])
    head = "time_s,command_deg,driving_deg,driven_deg"
    np.savetxt(log, rows, "%.9f", ",", header=head, comments="")


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


def main() -> None:
    """Run the machine, or draw its logs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--table", type=Path)
    parser.add_argument("--picture", type=Path)
    asked = parser.parse_args()
    if asked.picture is not None:
        draw(asked.logs, asked.picture)
    else:
        record(asked.logs[0], "" if asked.table is None else asked.table.read_text())


if __name__ == "__main__":
    main()
