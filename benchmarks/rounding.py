"""Does an answer depend on the last digits of the log?

    python -m benchmarks.rounding [--logs 160] [--folder DIR ...]

Every log is fitted twice: as it is, and with its times and readings changed by one part in 10¹²,
which is what another processor, another unit or another file format does to them. Whole counts stay
whole. Outcome, names (determined, significant) and sentences must not change, and no value by more
than a thousandth of its standard error. A folder holds `pair.toml` and `log*.csv`. Logs without
noise are judged by words alone: there the change is the noise. Writes results/rounding.json.
"""

import argparse
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

import vttig_jax
from vttig_jax.base.errors import VttigError
from vttig_jax.base.units import DEG
from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit
from vttig_jax.logs.channel.channel import Channel
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import Drive, GearPair
from vttig_jax.pair.schema import Encoder
from vttig_jax.rig.imperfections import EncoderError, Noise
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

from .environment import write

CHANGE = 1e-12
MOST_OF_A_STD = 1e-3
LEAST_UNCHANGED = 0.99
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FITS = Path(__file__).resolve().parents[1] / "fits"
MEASURED = (
    ("kuka_kr300/kr300_A_axes123.csv", "kuka_kr300/axis1.toml"),
    ("kuka_kr300/kr300_A_axes123.csv", "kuka_kr300/axis2.toml"),
    ("kuka_kr300/kr300_A_axes123.csv", "kuka_kr300/axis3.toml"),
    ("worm_mount/ap_gt1100.csv", "worm_mount/pair.toml"),
    ("worm_mount/ap_24turns.csv", "worm_mount/pair.toml"),
    ("worm_mount/cge.csv", "worm_mount/cge.toml"),
)

Named = tuple[str, EncoderLog, GearPair | Drive]
Samples = Float[np.ndarray, " n"]


def drawn_logs(count: int) -> Iterator[Named]:
    """Short runs of the paper's rig: counts, the same readings as angles, and without noise."""
    for seed in range(count):
        kind = ("counts", "angles", "angles", "noise-free")[seed % 4]
        generator = np.random.default_rng(seed)
        motion = PassMotion(
            speed_rpm=float(generator.uniform(20, 120)),
            reversal_deg=float(generator.uniform(1080, 5760)),
            dwell_s=0.5,
        )
        rig = replace(paper_rig(seed, motion), rate_hz=700.0)
        if kind == "noise-free":
            perfect, gears = EncoderError(), (rig.pair.driving, rig.pair.driven)
            without_counts = tuple(replace(gear, encoder=Encoder()) for gear in gears)
            pair = eqx.tree_at(lambda p: (p.driving, p.driven), rig.pair, without_counts)
            rig = replace(
                rig,
                pair=pair,
                noise=Noise(),
                orders=(),
                driving_encoder=perfect,
                driven_encoder=perfect,
            )
        log = rig.log(seed)
        if kind == "angles":
            log = as_angles(log, rig.pair)
        yield kind, log, rig.pair


def as_angles(log: EncoderLog, pair: GearPair | Drive) -> EncoderLog:
    """The log with readings in degrees."""
    angles = (log.driving_angle / DEG, log.driven_angle / DEG)
    return EncoderLog.from_arrays(log.time, *angles, pair=pair, unit="deg")


def logs_of(folders: list[Path]) -> Iterator[Named]:
    """The measured logs, where they are beside the repository, and those of further folders."""
    for name, pair_file in MEASURED:
        if (DATA / name).is_file():
            pair = vttig_jax.load_pair(FITS / pair_file)
            yield f"measured {Path(pair_file).stem}", vttig_jax.read_log(DATA / name, pair), pair
    for folder in folders:
        pair = vttig_jax.load_pair(folder / "pair.toml")
        for path in sorted(folder.glob("log*.csv")):
            try:
                yield folder.name.rstrip("0123456789"), vttig_jax.read_log(path, pair), pair
            except VttigError:
                continue  # a log that is no log says nothing of rounding


def changed(log: EncoderLog, generator: np.random.Generator) -> EncoderLog:
    """The log with every number that is no whole one changed in its last digits."""

    def moved(values: Samples | None) -> Samples | None:
        if values is None:
            return None
        return values * (1 + CHANGE * generator.standard_normal(len(values)))

    def channel(own: Channel | None) -> Channel | None:
        if own is None or np.issubdtype(own.reading.dtype, np.integer):
            return own
        return replace(own, reading=moved(own.reading))

    driving = channel(log.driving)
    assert driving is not None
    time = log.time + CHANGE * np.median(np.diff(log.time)) * generator.standard_normal(len(log))
    return replace(
        log,
        time=time,
        driving=driving,
        driven=channel(log.driven),
        error=moved(log.error),
        torque=moved(log.torque),
    )


def answer(log: EncoderLog, pair: GearPair | Drive) -> Fit | str:
    """The fit, or the sentence of its refusal."""
    try:
        return fit(log, pair)
    except VttigError as error:
        return words(str(error))


def words(text: str) -> str:
    """A sentence without its numbers."""
    return re.sub(r"[-+−]?\d[\d.e+−-]*", "#", text)


def compared(kind: str, one: Fit | str, other: Fit | str) -> dict[str, Any]:
    """What changed between two answers."""
    if isinstance(one, str) or isinstance(other, str):
        return {"refused": True, "words": one == other, "moved": 0.0}
    return {
        "refused": False,
        "words": said(one) == said(other),
        "moved": 0.0 if kind == "noise-free" else largest_move(one, other),
        "differences": [
            f"{a} | {b}" for a, b in zip(said(one), said(other), strict=False) if a != b
        ],
    }


def said(result: Fit) -> list[str]:
    """Outcome, names and sentences."""
    names = [
        f"{p.name} {p.determined} {p.significant} {p.reason}"
        for p in (*result.parameters.values(), *result.regressors)
    ]
    return [result.outcome, result.noise.model, *names, *(words(note) for note in result.notes)]


def largest_move(one: Fit, other: Fit) -> float:
    """Largest change of a parameter in standard errors."""
    moves = [0.0]
    for name, parameter in one.parameters.items():
        changed_to = other.parameters[name].value
        if parameter.value is not None and changed_to is not None and parameter.std:
            moves.append(abs(changed_to - parameter.value) / parameter.std)
    return max(moves)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=160)
    parser.add_argument("--folder", type=Path, nargs="*", default=[])
    arguments = parser.parse_args()
    vttig_jax.enable_x64()
    rows, kinds = [], Counter[str]()
    everything = [*drawn_logs(arguments.logs), *logs_of(arguments.folder)]
    for number, (kind, log, pair) in enumerate(everything):
        generator = np.random.default_rng([number, 1])
        row = compared(kind, answer(log, pair), answer(changed(log, generator), pair))
        rows.append({"kind": kind} | row)
        kinds[kind] += 1
        if not row["words"] or row["moved"] > MOST_OF_A_STD:
            print(number, kind, row)
    unchanged = float(np.mean([row["words"] for row in rows]))
    largest = max(row["moved"] for row in rows)
    record = {
        "change": CHANGE,
        "logs": dict(kinds),
        "refused": sum(row["refused"] for row in rows),
        "words_unchanged": unchanged,
        "largest_move_of_a_std": largest,
        "holds": unchanged >= LEAST_UNCHANGED and largest <= MOST_OF_A_STD,
        "changed": [row for row in rows if not row["words"] or row["moved"] > MOST_OF_A_STD],
    }
    write("rounding.json", record)
    print(record)


if __name__ == "__main__":
    main()
