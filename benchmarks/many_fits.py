"""A thousand logs of 18 000 samples in one table, beside `vttig_jax.fit` of each.

    python -m benchmarks.many_fits [--logs 1000] [--peers 10]

Every log is of the rig of the paper with encoders, pitch orders and mesh, forward and back at 120
rpm. First the table is compared with single fits (the gate, 1e-6 standard errors). Then these are
timed, in process time and in wall time:

- table: `vttig_jax.fit_many` of all logs, with the checks of ratio, flanks, slips and outliers;
- fits: `vttig_jax.fit` of some logs, whose result also has orders, checks and findings.

Eight logs are drawn with the rig's exact kinematics, and the others are these with further noise,
drawn from their number. Writes results/many_fits.json.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import vttig_jax
from vttig_jax import EncoderLog, FitTable
from vttig_jax.rig import PassMotion, paper_rig

from .environment import write

DRAWN = 8
MOTION = PassMotion(speed_rpm=120.0, reversal_deg=2835.0, dwell_s=0.3, ramp_s=0.3)
"""18 157 samples at 1987 Hz."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--peers", type=int, default=10, help="logs that are fitted alone too")
    chosen = parser.parse_args()
    vttig_jax.enable_x64()
    rig = paper_rig(0, MOTION)
    drawn = [rig.log(seed) for seed in range(DRAWN)]
    record: dict[str, Any] = {"logs": chosen.logs, "samples": len(drawn[0])}
    gate = _gate(vttig_jax.fit_many(drawn[:3], rig.pair), drawn[:3], rig.pair)
    assert gate < 1e-6, gate
    record["gate_standard_errors"] = gate
    logs = _logs(drawn, rig.pair, chosen.logs)
    record["table"], table = _timed(lambda: vttig_jax.fit_many(logs, rig.pair), chosen.logs)
    assert table.is_fitted.all()
    some = [drawn[number % DRAWN] for number in range(chosen.peers)]
    record["fits"], _ = _timed(lambda: [vttig_jax.fit(log, rig.pair) for log in some], chosen.peers)
    record["table_wall_s"] = chosen.logs * record["table"]["wall_s"]
    write("many_fits.json", record)
    for name, value in record.items():
        print(f"{name}: {value}")


def _timed(work: Callable[[], Any], share: int) -> tuple[dict[str, float], Any]:
    """Process and wall time of one of `share` equal parts of the work, and its result."""
    process, wall = time.process_time(), time.perf_counter()
    result = work()
    spent = time.process_time() - process, time.perf_counter() - wall
    return {"process_s": spent[0] / share, "wall_s": spent[1] / share}, result


def _gate(table: FitTable, logs: list[EncoderLog], pair: Any) -> float:
    """Largest difference from `vttig_jax.fit` of each log, in standard errors."""
    worst = 0.0
    for number, log in enumerate(logs):
        for name, one in vttig_jax.fit(log, pair).parameters.items():
            if one.value is not None and one.std and name in table.columns:
                worst = max(worst, abs(table.columns[name][number] - one.value) / one.std)
    return worst


def _logs(drawn: list[EncoderLog], pair: Any, count: int) -> Iterator[EncoderLog]:
    for number in range(count):
        log = drawn[number % DRAWN]
        assert log.driven is not None  # a log of two encoders
        more = np.random.default_rng(number).normal(0.0, 0.3, len(log)).round().astype(int)
        yield EncoderLog.from_arrays(
            log.time, log.driving.reading, log.driven.reading + more, pair=pair
        )


if __name__ == "__main__":
    main()
