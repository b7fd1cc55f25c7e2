"""Do the claims of a fit hold over rigs of any kind, and is what a log tells told?

    python -m benchmarks.mixed_rigs --zoo zoo.py [--rigs 500] [--seed 0] [--jobs 2] [--only polled]

Every rig is of a kind that is drawn: one of the kinds of `zoo.py` (rigs that misbehave as real ones
do, with a truth and with the half-width up to which a log tells each number; the file is not part
of this project), or the paper's rig with drawn eccentricities, speed, length, rate and delay.
`vttig fit --json` runs on each. A claim is a number with an interval; an amplitude that is not
significant claims [0, upper95]. Counted are claims outside their interval, claims farther from the
truth than twice the half-width, and numbers that the log tells but that are called undetermined or
given wider. Good logs that are refused are counted too. Writes results/mixed_rigs.json.
"""

import argparse
import io
import json
import multiprocessing
import runpy
import tempfile
from collections import Counter
from collections.abc import Iterable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from scipy.stats import binomtest

from vttig_jax.base.runtime import enable_x64
from vttig_jax.cli.main import main as vttig
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.pair.gear_pair import Eccentricities, spec_of
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig
from vttig_jax.rig.synthetic import SyntheticRig

from .environment import write

PAPER = "paper"
PAPER_SHARE = 0.25
WITHOUT_NUMBERS = ("slipped", "swapped")  # kinds whose right answer is a refusal
NOISE_HALF_WIDTHS = {
    "driving_eccentricity_mm": 4.1e-4,
    "driven_eccentricity_mm": 3.8e-4,
    "driving_phase_deg": 1.1,
    "driven_phase_deg": 0.8,
    "constant_backlash_deg": 2e-4,
}
"""1.96 times the standard errors that `benchmarks.accuracy` demands of 21 s in each direction."""

WIDTHS_ALLOWED = 2.5  # times those; short runs resolve their orders less well
CAUGHT = 2.0  # half-widths


@dataclass(frozen=True)
class Claim:
    """One number of one rig: its truth beside what the fit states (None: undetermined)."""

    kind: str
    seed: int
    name: str
    truth: float
    widest: float | None
    value: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def half_widths_off(self) -> float:
        """Distance of the truth from the middle of the interval, in half-widths."""
        if self.low is None or self.high is None:
            return 0.0
        half = (self.high - self.low) / 2
        return abs(self.truth - (self.high + self.low) / 2) / max(half, 1e-300)

    @property
    def untold(self) -> bool:
        """Whether the log tells this number, and the fit does not or less well."""
        if self.widest is None:
            return False
        return self.low is None or self.high is None or (self.high - self.low) / 2 > self.widest


@dataclass(frozen=True)
class Answer:
    """What `vttig fit` said of one rig."""

    kind: str
    seed: int
    code: int
    refusal: str
    claims: tuple[Claim, ...]


def answer(task: tuple[str, int, str]) -> Answer:
    """Make the rig of one kind and seed in a folder of its own, fit it and gather its claims."""
    kind, seed, zoo = task
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if kind == PAPER:
            truth = write_paper(seed, folder)
        else:
            truth = zoo_file(zoo)["write"](kind, seed, folder)["numbers"]
        logs = sorted(map(str, folder.glob("log*.csv")))
        code, record, said = called(["fit", *logs, "--pair", str(folder / "pair.toml"), "--json"])
        said = said.replace(f"{folder}/", "")
    if "parameters" not in record:
        return Answer(kind, seed, code, said.strip().splitlines()[-1] if said.strip() else "", ())
    claims = tuple(
        Claim(kind, seed, name, number["value"], number["widest"], *stated(record, name, number))
        for name, number in truth.items()
    )
    return Answer(kind, seed, code, "", claims)


@cache
def zoo_file(path: str) -> dict[str, Any]:
    """Return the functions of `zoo.py`."""
    return runpy.run_path(path, run_name="zoo")


def called(arguments: list[str]) -> tuple[int, dict[str, Any], str]:
    """Run `vttig` in this process; return exit code, JSON object and standard error."""
    out, said = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(said):
        code = vttig(arguments)
    try:
        return code, json.loads(out.getvalue()), said.getvalue()
    except ValueError:
        return code, {}, said.getvalue()


def stated(record: dict[str, Any], name: str, number: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Return value and interval of a number that is stated as determined, else three Nones."""
    gap = record["checks"].get("gap_over_angles_covered")
    found = gap if name == "gap" else record["parameters"].get(name)
    if not found or not found["determined"] or found["value"] is None:
        return None, None, None
    value, low, high = found["value"], found.get("low95"), found.get("high95")
    if found.get("significant") is False and name.endswith(("_arcsec", "_mm")):
        low, high = 0.0, found.get("upper95") or high
    if name.endswith("phase_deg"):  # the interval lies around the value and may leave [0, 360)
        turn = 360.0 * round((number["value"] - value) / 360.0)
        value, low, high = value + turn, low + turn, high + turn
    return value, low, high


def write_paper(seed: int, folder: Path) -> dict[str, dict[str, Any]]:
    """Write log and pair file of the paper's rig with drawn properties; return its truths."""
    rng = np.random.default_rng([seed, *PAPER.encode()])
    speed_rpm, turns = float(rng.uniform(20, 120)), float(rng.uniform(6, 24))
    motion = PassMotion(speed_rpm=speed_rpm, reversal_deg=360.0 * turns)
    base = paper_rig(int(rng.integers(2**31)), motion)
    drawn = {
        "driving_mm": float(rng.uniform(0.01, 0.03)),
        "driving_phase_deg": float(rng.uniform(0, 360)),
        "driven_mm": float(rng.uniform(0.01, 0.03)),
        "driven_phase_deg": float(rng.uniform(0, 360)),
        "constant_backlash_deg": float(rng.uniform(0.09, 0.15)),  # open at every angle
    }
    rig = SyntheticRig(
        pair=base.pair,
        eccentricities=Eccentricities(**drawn),
        motion=motion,
        orders=base.orders,
        driving_encoder=base.driving_encoder,
        driven_encoder=base.driven_encoder,
        noise=base.noise,
        delay_s=float(rng.choice([0.0, rng.uniform(-0.001, 0.001)])),
        rate_hz=float(rng.uniform(500, 2000)),
    )
    (folder / "log.csv").write_text(log_csv(rig.log(int(rng.integers(2**31)))))
    (folder / "pair.toml").write_text(tomli_w.dumps(spec_table(spec_of(rig.pair))))
    shorter = np.sqrt(21.0 / (turns * 60.0 / speed_rpm))
    numbers: dict[str, dict[str, Any]] = {
        "delay_s": {"value": rig.delay_s, "widest": None},
        "driving_encoder_arcsec": {"value": 18.0, "widest": None},
        "driven_encoder_arcsec": {"value": 18.0, "widest": None},
    }
    for shaft in ("driving", "driven"):
        scale = paper_rig().eccentricities.driving_mm / drawn[f"{shaft}_mm"]
        for name, key, gain in (
            (f"{shaft}_eccentricity_mm", f"{shaft}_mm", 1.0),
            (f"{shaft}_phase_deg", f"{shaft}_phase_deg", scale),
        ):
            widest = WIDTHS_ALLOWED * NOISE_HALF_WIDTHS[name] * shorter * gain
            numbers[name] = {"value": drawn[key], "widest": float(widest)}
    numbers["constant_backlash_deg"] = {"value": drawn["constant_backlash_deg"], "widest": None}
    return numbers


def drawn_tasks(rigs: int, seed: int, zoo: str, only: str) -> list[tuple[str, int, str]]:
    """Draw the kind of every rig; seeds count on from `seed`."""
    rng = np.random.default_rng(seed)
    kinds = [kind for kind in zoo_file(zoo)["CASES"] if kind not in WITHOUT_NUMBERS]
    tasks = []
    for place in range(rigs):
        kind = PAPER if rng.random() < PAPER_SHARE else str(rng.choice(kinds))
        if only in kind:
            tasks.append((kind, 10_000 * (seed + 1) + place, zoo))
    return tasks


def summary(answers: Iterable[Answer]) -> dict[str, Any]:
    """Counts over all rigs, and the claims that are far off."""
    answers = list(answers)
    claims = [claim for answer in answers for claim in answer.claims]
    made = [claim for claim in claims if claim.low is not None]
    asked = [claim for claim in claims if claim.widest is not None]
    outside = [claim for claim in made if claim.half_widths_off > 1.0]
    far = [claim for claim in made if claim.half_widths_off > CAUGHT]
    untold = [claim for claim in asked if claim.untold]
    share = {
        "outside": (len(outside), len(made)),
        "outside_twice_the_half_width": (len(far), len(made)),
        "told_but_undetermined_or_wider": (len(untold), len(asked)),
    }
    return {
        "rigs": len(answers),
        "by_kind": dict(Counter(answer.kind for answer in answers)),
        "refused": [asdict(answer) for answer in answers if answer.refusal],
        **{name: _share(*counts) for name, counts in share.items()},
        "far": [asdict(claim) | {"off": claim.half_widths_off} for claim in far],
        "outside_by_kind": dict(Counter(f"{c.kind} {c.name}" for c in outside)),
        "untold_by_kind": dict(Counter(f"{c.kind} {c.name}" for c in untold)),
    }


def _share(count: int, of: int) -> dict[str, float]:
    interval = binomtest(count, max(of, 1)).proportion_ci(0.95, "exact")
    return {
        "count": count,
        "of": of,
        "share": count / max(of, 1),
        "low95": float(interval.low),
        "high95": float(interval.high),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--zoo", required=True, help="path of zoo.py")
    parser.add_argument("--rigs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="part of the name of the kinds to run")
    chosen = parser.parse_args()
    tasks = drawn_tasks(chosen.rigs, chosen.seed, chosen.zoo, chosen.only)
    answers: list[Answer] = []
    with multiprocessing.get_context("spawn").Pool(chosen.jobs, enable_x64) as pool:
        for found in pool.imap_unordered(answer, tasks):
            answers.append(found)
            for claim in found.claims:
                if claim.half_widths_off > 1.0:
                    print(f"{claim.half_widths_off:.2f} half-widths: {claim}", flush=True)
            if found.refusal:
                print(f"{found.kind} {found.seed}: exit {found.code}, {found.refusal}", flush=True)
    record = summary(answers)
    print(json.dumps({k: v for k, v in record.items() if k not in ("far", "refused")}, indent=1))
    write("mixed_rigs.json", {"options": {"rigs": len(tasks), "seed": chosen.seed}, **record})


if __name__ == "__main__":
    main()
