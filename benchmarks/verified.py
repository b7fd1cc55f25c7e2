"""Does `vttig verify` name what is wrong with a compensation, and nothing where all is right?

    python -m benchmarks.verified [--rigs 200] [--seed 0]

Every rig is a drive of a drawn ratio, with drawn errors of both shafts on each flank, a gap, and
noise with a drawn memory. A log of both shafts is fitted, the error table of the driven axis made,
and the axis run against its command for some turns there and back: with the table, and with each
fault (another zero of 5° or more, a limit at a tenth to a half of the speed that the table asks
for, …). The axis stands where the *drawn* error says, not the fitted one. Writes
results/verified.json.
"""

import argparse
import io
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from vttig_jax.base.errors import VttigError
from vttig_jax.base.runtime import enable_x64
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.cli.main import main as vttig
from vttig_jax.control.compensation.correction import CorrectionTable
from vttig_jax.runs.axis_table import AxisSetting, axis_table
from vttig_jax.runs.run import Run, open_run
from vttig_jax.runs.verification import verify

from .environment import write

RATIOS = [Fraction(1, 2), Fraction(1, 8), Fraction(2, 3), Fraction(3, 4), Fraction(2, 5)]
SPEED, RATE, RAMP = REV, 50.0, 0.5  # of the driving shaft in a second; samples and ramp, s

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Rig:
    """Drive with a transmission error of each flank, rad, and noise of `noise` rad."""

    ratio: Fraction
    errors: dict[str, Curve]
    noise: float
    memory: float

    @classmethod
    def drawn(cls, seed: int) -> "Rig":
        """Draw a rig: first orders of 20 to 60″, others of a fifth; flanks differ in phase."""
        rng = np.random.default_rng(seed)
        ratio = RATIOS[rng.integers(len(RATIOS))]
        orders = np.array([1, 2, 3, float(ratio), 2 * float(ratio)])
        size = np.array([1, 0.2, 0.2, 1, 0.2]) * rng.uniform(20, 60, 5) * ARCSEC
        phase, gap = rng.uniform(0, REV, 5), rng.uniform(20, 200) * ARCSEC
        own = {flank: phase + rng.normal(0, 0.5, 5) for flank in "AB"}

        def error_on(flank: str) -> Curve:
            level = gap if flank == "B" else 0.0
            return lambda x: np.sin(np.multiply.outer(x, orders) + own[flank]) @ size + level

        noise = 10 ** rng.uniform(-0.5, 0.7) * ARCSEC
        return cls(ratio, {f: error_on(f) for f in "AB"}, noise, rng.uniform(0, 0.8))

    def noisy(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return noise with memory, rad."""
        found = lfilter([1.0], [1.0, -self.memory], rng.standard_normal(count))
        return self.noise * np.sqrt(1 - self.memory**2) * found


def there_and_back(turns: float, times: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, driving angles and directions of passes of so many turns at `SPEED`."""
    edges, speeds = [0.0], [0.0]
    for sign in (1, -1) * times:
        for duration, speed in ((RAMP, sign), (turns * REV / SPEED, sign), (RAMP, 0), (0.3, 0)):
            edges.append(edges[-1] + duration)
            speeds.append(speed * SPEED)
    fine = np.linspace(0, edges[-1], 200_001)
    speed = np.interp(fine, edges, speeds)
    angle = np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2) * fine[1]])
    moved = np.sign(speed)
    last = np.maximum.accumulate(np.where(moved != 0, np.arange(len(moved)), 0))
    time = np.arange(0, edges[-1], 1 / RATE)
    return time, np.interp(time, fine, angle), moved[last[np.searchsorted(fine, time)]]


def written(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Write columns as CSV."""
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, "%.9f", ",", header=",".join(columns), comments="")


def called(*arguments: object) -> None:
    """Run `vttig` quietly."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        vttig([str(one) for one in arguments])


def fitted(rig: Rig, folder: Path, rng: np.random.Generator) -> None:
    """Write a log of both shafts over four hunting periods each way, and its fit, to `run`."""
    time, driving, sign = there_and_back(4 * rig.ratio.denominator, 1)
    te = np.where(sign >= 0, *(rig.errors[f](driving) for f in "AB"))
    driven = float(rig.ratio) * driving + te + rig.noisy(len(time), rng)
    degrees = {"driving_deg": driving / DEG, "driven_deg": driven / DEG}
    written(folder / "log.csv", {"time_s": time, **degrees})
    (folder / "pair.toml").write_text(
        f'[drive]\nratio = "{rig.ratio}"\n[fit]\ndriving_orders = [1, 2, 3]\n'
        'driven_orders = [1, 2]\n[log]\nzero = "reading"\n'
    )
    options = ("--delay", "off", "--ratio-within", "0", "--no-figures")
    called(
        "fit", folder / "log.csv", "--pair", folder / "pair.toml", "--out", folder / "run", *options
    )


def faults(rig: Rig, rng: np.random.Generator) -> Iterator[tuple[str, dict]]:
    """Yield the right table and every fault, as changes of the axis."""
    turns = rig.ratio.numerator
    yield "right", {}
    yield "nothing_loaded", {"factor": 0.0}
    yield "sign_reversed", {"factor": -1.0}
    yield "directions_exchanged", {"exchanged": True}
    yield "zero_shifted", {"shift": rng.choice([-1, 1]) * rng.uniform(5, 90) * DEG}
    yield "rate_limited", {"limit": rng.uniform(0.1, 0.5)}
    if turns > 1:
        yield "another_turn", {"turn": int(rng.integers(1, turns))}


def other_tables(
    rig: Rig, run: Run, axis: AxisSetting, rng: np.random.Generator
) -> Iterator[CorrectionTable]:
    """Yield other tables than that of the axis: of a zero 20° to 160° away, and of a drawn rig."""
    zero_deg = rng.choice([-1, 1]) * rng.uniform(20, 160)
    yield axis_table(run.fit, None, axis._replace(zero_deg=zero_deg)).table
    other = replace(Rig.drawn(int(rng.integers(2**31))), ratio=rig.ratio)
    with tempfile.TemporaryDirectory() as place:
        fitted(other, Path(place), rng)
        yield axis_table(open_run(Path(place) / "run").fit, None, axis).table


def commanded(
    rig: Rig,
    table: CorrectionTable,
    path: Path,
    rng: np.random.Generator,
    *,
    factor: float = 1.0,
    exchanged: bool = False,
    shift: float = 0.0,
    turn: int = 0,
    limit: float | None = None,
) -> None:
    """Write a log of the axis against its command over the table's turn, three times each way."""
    ratio = float(rig.ratio)
    time, driving, sign = there_and_back(1 / ratio - 0.6, 3)
    command = ratio * (driving + 0.05 * REV)
    forward = (sign >= 0) ^ exchanged
    added = factor * np.where(forward, *(table.at(n, command) for n in ("forward", "reverse")))
    if limit is not None:
        steady = np.abs(np.gradient(command, time)) > 0.99 * ratio * SPEED
        steps = np.abs(np.gradient(added, time))[steady]
        most, target = limit * np.quantile(steps, 0.99) / RATE, added.copy()
        for k in range(1, len(added)):
            added[k] = added[k - 1] + np.clip(target[k] - added[k - 1], -most, most)
    angle = (command + added - shift + turn * REV) / ratio
    te = np.where(sign >= 0, *(rig.errors[f](angle) for f in "AB"))
    driven = command + added + te + 0.3 + rig.noisy(len(time), rng)
    degrees = {"command_deg": command / DEG, "driven_deg": driven / DEG}
    written(path, {"time_s": time, **degrees})


def answers(seed: int) -> Iterator[tuple[str, dict]]:
    """Yield what is wrong with the axis of a rig, and what `vttig verify` says."""
    rig, rng = Rig.drawn(seed), np.random.default_rng(10_000 + seed)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        fitted(rig, folder, rng)
        run, axis = open_run(folder / "run"), AxisSetting(travel_deg=(0.0, 360.0))
        table = axis_table(run.fit, None, axis).table
        axes = [(*one, table) for one in faults(rig, rng)]
        axes += [("unexplained", {}, one) for one in other_tables(rig, run, axis, rng)]
        for name, change, loaded in axes:
            log = folder / f"{name}.csv"
            commanded(rig, loaded, log, rng, **change)
            try:
                yield name, verify(run, [log], axis) | {"change": str(change)}
            except VttigError as error:
                yield name, {"message": error.message}


def main() -> None:
    """Run the study and write its result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    enable_x64()
    told: dict[str, Counter] = {}
    held = [0, 0]
    for seed in range(asked.seed, asked.seed + asked.rigs):
        for name, record in answers(seed):
            if "logs" not in record:
                told.setdefault(name, Counter())[f"refused: {record['message'][:60]}"] += 1
                continue
            (found,) = record["logs"]
            said = found["likely"] if found["likely"] != "right" or name == "right" else "missed"
            told.setdefault(name, Counter())[said] += 1
            if name == "right":
                for left in found["left_arcsec"].values():
                    low, high = left["predicted95"]
                    held[0] += left["low95"] <= high and low <= left["high95"]
                    held[1] += 1
            if asked.verbose and (said != name or name == "right"):
                print(seed, name, record["change"], found, flush=True)
    rows = {
        name: {"rigs": counts.total(), "named": counts[name] / counts.total(), "said": dict(counts)}
        for name, counts in told.items()
    }
    for name, row in rows.items():
        print(f"{name:22} {row['rigs']:4d} rigs, named on {row['named']:.1%}: {row['said']}")
    print(f"measured and predicted intervals meet in {held[0] / held[1]:.1%} of {held[1]}")
    write("verified.json", {"rows": rows, "intervals_meet": held[0] / held[1]})


if __name__ == "__main__":
    main()
