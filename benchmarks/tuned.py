"""What `tune` finds on the paper's rig, w = 10: the table of docs/simulation.md.

    OMP_NUM_THREADS=1 python -m benchmarks.tuned      # 15 min

Writes results/tuned.json.
"""

from typing import Any

import numpy as np

import vttig_jax

from .environment import write
from .simulation_cases import PAIR, RIG

MARGIN = "judgement.margin_mm"
ONE = {"motion.reversal_deg": {"from": 360, "to": 6000, "num": 48}}
"""48 turns, each in another place of the hunting period."""

SEVERAL = {
    "motion.reversal_deg": {"from": 400, "to": 5800, "num": 16},
    "motion.speed_rpm": [30.0, 60.0, 100.0],
    "motion.ramp_s": [0.3, 0.6],
}


def rigs(count: int) -> dict[str, Any]:
    """Axes of rigs around the paper's: the plants of a controller that believes the paper's."""
    draw = np.random.default_rng(0)
    widths = {"driving_mm": 2e-4, "driven_mm": 2e-4, "constant_backlash_deg": 1e-3}
    axes = {
        f"eccentricities.{name}": (RIG[name] + width * draw.normal(size=count)).tolist()
        for name, width in widths.items()
    }
    turns = {"motion.reversal_deg": {"from": 400, "to": 5800, "num": 12}}
    return {**turns, **axes, "zip": [list(axes)]}


ROWS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "one motion, margin": ("acceleration", ONE, {"free": [MARGIN]}),
    "one motion, all": ("acceleration", ONE, {}),
    "several motions, margin": ("acceleration", SEVERAL, {"free": [MARGIN]}),
    "several motions, all": ("acceleration", SEVERAL, {}),
    "20 rigs, margin and horizon": (
        "predictive",
        rigs(20),
        {"free": [MARGIN, "judgement.horizon_s"]},
    ),
}


def main() -> None:
    vttig_jax.prepare_cpu(1)
    vttig_jax.enable_x64()
    record: dict[str, Any] = {}
    for name, (controller, axes, options) in ROWS.items():
        table = {"pair": "pair.toml", "eccentricities": RIG, "controller": controller}
        given = {**table, "motion": {"dwell_s": 0.3}, "map": RIG, "sweep": axes}
        found = vttig_jax.tune(given, PAIR, **options).to_json()
        kept = ("cases", "searched", "values", "before", "after", "notes")
        record[name] = {key: found[key] for key in kept}
        print(name, found["values"], found["before"], found["after"], sep="\n  ", flush=True)
    write("tuned.json", record)


if __name__ == "__main__":
    main()
