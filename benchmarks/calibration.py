"""Coverage of the intervals in every scenario, short and long: the table of docs/calibration.md.

    python -m benchmarks.calibration [--rigs 2000] [--sampled 400] [--scenario NAME]...

Every rig is drawn from the prior, logged sample by sample through the exact kinematics, compressed
and fitted. `--sampled` rigs of the cases in `SAMPLED` are sampled with emcee too. Writes
results/calibration.json after every case.
"""

import argparse
import json
import sys
import time
from typing import get_args

import vttig_jax
from vttig_jax.base.files.json_io import dumps
from vttig_jax.posterior.calibration.calibrate import Calibration, run_case
from vttig_jax.posterior.calibration.case_result import CaseResult
from vttig_jax.posterior.calibration.program import Program
from vttig_jax.posterior.calibration.scenarios import SCENARIOS, Length

from .environment import RESULTS, environment

SAMPLED = ("ar_4ms75 (short)", "encoders (short)")
"""Cases of which a part is sampled."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=2000)
    parser.add_argument("--sampled", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenario", choices=list(SCENARIOS), action="append")
    chosen = parser.parse_args()
    vttig_jax.enable_x64()
    cases: list[CaseResult] = []
    found = Calibration((), chosen.seed)
    start = time.perf_counter()
    for length in get_args(Length):
        for name in chosen.scenario or SCENARIOS:
            scenario = SCENARIOS[name].of_length(length)
            sampled = chosen.sampled if scenario.case in SAMPLED else 0
            program = Program(scenario)
            cases.append(run_case(program, chosen.rigs, chosen.seed, sampled, lambda *_: None))
            found = Calibration(tuple(cases), chosen.seed)
            print(f"{scenario.case}: {cases[-1].seconds:.0f} s, {found.verdict(cases[-1])}")
            sys.stdout.flush()
            _write(found, time.perf_counter() - start, chosen)
    print(f"\n{found}")


def _write(found: Calibration, seconds: float, chosen: argparse.Namespace) -> None:
    """All cases so far; a run that is interrupted leaves what it has."""
    RESULTS.mkdir(exist_ok=True)
    options = {"rigs": chosen.rigs, "sampled": chosen.sampled, "seed": chosen.seed}
    record = {
        "environment": environment(),
        "options": options,
        "seconds": seconds,
        "table": str(found).splitlines(),
        **json.loads(dumps(found.to_json())),
    }
    (RESULTS / "calibration.json").write_text(dumps(record) + "\n")


if __name__ == "__main__":
    main()
