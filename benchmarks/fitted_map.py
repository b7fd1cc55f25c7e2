"""What the fitted map is worth in the simulation: the demo's rig, whose truth is known.

    OMP_NUM_THREADS=1 python -m benchmarks.fitted_map      # 4 min

A log of the paper's rig is fitted and sampled. Then the true rig, with all its orders, turns at a
thousand places of the hunting period, and the predictive controller closes the gap by the five
numbers of the fit or by its whole map. `vttig sweep` is asked the same question without the truth:
its plants are posterior draws. Further rows: the error of the table, derivatives beside
differences, and the time of a lane-step. Writes results/fitted_map.json.
"""

import tempfile
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import vttig_jax
from vttig_jax import Eccentricities, Gear, GearPair
from vttig_jax.base.units import DEG, REV
from vttig_jax.control import Predictive, Reversal, Scenario, run
from vttig_jax.control.simulation.case import NEAR_MM
from vttig_jax.kinematics import tabulate_flanks
from vttig_jax.rig import paper_pair, paper_rig

from .environment import write
from .simulation_cases import BASE, RIG, BatchRunner, cases_of, ns_per_lane_step, stack_of, summary

FIVE = ("driving_mm", "driving_phase_deg", "driven_mm", "driven_phase_deg", "constant_backlash_deg")
TURNS, DRAWS = 1000, 40
_PLACES = 200
"""Turns of each draw; chosen, so that the sweep has 8000 cases."""


def main() -> None:
    vttig_jax.prepare_cpu(2)
    vttig_jax.enable_x64()
    record: dict[str, Any] = {"table": table(), "gradient": gradient(), "lane_step": lane_step()}
    record |= reversals()
    write("fitted_map.json", record)
    for name, value in record.items():
        print(f"{name}: {value}")


def table() -> dict[str, float]:
    """Largest error over 10⁵ angles of the paper's rig with its mesh order 45, degrees."""
    model = paper_rig().flank_model()
    found = tabulate_flanks(model, paper_pair().hunting_turns)
    angle = np.random.default_rng(0).uniform(0.0, 64 * REV, 100_000)
    errors = [
        np.abs(
            found.transmission_error(angle, flank) - model.transmission_error(angle, flank)
        ).max()
        for flank in ("A", "B")
    ]
    return {"error_deg": float(max(errors)) / DEG, "asked": 1e-9}


def gradient() -> dict[str, Any]:
    """Derivatives of the gap left by e₁, θ₁, e₂, θ₂, β and margin beside central differences."""
    motion = Reversal(reversal_deg=360.0, dwell_s=0.1, ramp_s=0.2)

    @jax.jit
    def left(x):
        rig = Eccentricities(x[0], x[1], x[2], x[3], RIG["constant_backlash_deg"])
        scenario = Scenario(_pair(x[4]), rig, motion, controller=Predictive(margin_mm=x[5]))
        return run(scenario, rounding="none", smooth_width=0.1).metrics["residual_gap_deg"]

    x = jnp.array([*(RIG[name] for name in FIVE[:4]), 3.0, 0.01])
    slopes = np.asarray(jax.jacfwd(left)(x))
    worst = {}
    for share in (1e-4, 1e-5):
        steps = share * np.maximum(np.abs(x), 1e-2) * np.eye(6)
        differences = np.array([(left(x + h) - left(x - h)) / (2 * h.sum()) for h in steps])
        worst[f"relative_at_{share:g}"] = float(np.abs(differences / slopes - 1).max())
    return {"slopes": slopes.tolist(), **worst, "asked": 1e-5}


def _pair(helix_deg: Any) -> GearPair:
    gears = (Gear(teeth, helix_deg, helix_deg, 20.0) for teeth in (45, 80))
    return GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12)


def lane_step() -> dict[str, Any]:
    """Process time of a lane-step, ns: first-order flanks, and the rig's table, in turns."""
    runner = BatchRunner(jax.devices()[:1])
    maps = {"flanks": "exact", "plant_map": "rig", "controller_map": "rig"}
    record: dict[str, Any] = {"asked": 1.3}
    for controller in ("acceleration", "predictive"):
        stacks = {
            name: stack_of(
                cases_of(512, {**BASE, **values, "controller": controller}, (360.0, 5760.0))
            )
            for name, values in (("first_order", {}), ("table", maps))
        }
        found: dict[str, list[float]] = {name: [] for name in stacks}
        for _ in range(5):
            for name, stack in stacks.items():
                found[name] += ns_per_lane_step(runner, stack, 1, 4096, 1)
        times = np.array(found["table"]) / np.array(found["first_order"])
        record[controller] = {name: summary(ns) for name, ns in found.items()} | {
            "table_over_first_order": float(np.median(times))
        }
    return record


def reversals() -> dict[str, Any]:
    """Gap left and interference of the true rig, and the shares that a sweep over draws states."""
    rig = paper_rig()
    fit = vttig_jax.fit(rig.log(), rig.pair)
    five = {name: float(getattr(fit.eccentricities(), name)) for name in FIVE}
    scenario = {"controller": "predictive", "eccentricities": five, "motion": {"dwell_s": 0.3}}
    drawn = np.sort(np.random.default_rng(1).uniform(360.0, 6120.0, TURNS)).tolist()
    even = {"from": 360, "to": 6120, "num": _PLACES}
    record: dict[str, Any] = {"turns": TURNS, "draws": DRAWS, "asked_deg": [0.0008, 0.002]}
    with tempfile.TemporaryDirectory() as folder:
        vttig_jax.save_posterior(vttig_jax.sample(fit, seed=0), folder, figures=False)
        draws = {"rig": {"from": folder, "draws": DRAWS}}
        for name, believed in (("five_numbers", "eccentricities"), ("fitted_map", folder)):
            true, asked = (
                vttig_jax.sweep(
                    {**scenario, "sweep": {"motion.reversal_deg": places}},
                    rig.pair,
                    plant_map=rig.flank_model(),
                    controller_map=believed,
                )
                for places in (drawn, even)
            )
            table: dict[str, Any] = {**scenario, **draws, "sweep": {"motion.reversal_deg": even}}
            if believed == folder:
                del table["eccentricities"]
            table["sweep"]["controller"] = ["none", "predictive"]
            told = vttig_jax.sweep(table, rig.pair, controller_map=believed)
            gap = true.columns["residual_gap_deg"]
            group = told.to_json()["groups"][1]
            record[name] = {
                "gap_median_deg": float(np.median(gap)),
                "gap_largest_deg": float(gap.max()),
                "interference_largest_mm": float(true.columns["interference_mm"].max()),
                "interfering_share": _share(true),
                "share_of_the_true_rig_at_the_places_of_the_sweep": _share(asked),
                "share_that_the_sweep_states": group["interfering_share"],
                "its_95": group["interfering_share_95"],
                **_by_gap(told, rig.flank_model()),
            }
    return record


def _by_gap(told: vttig_jax.SweepTable, truth: Any) -> dict[str, float]:
    """Mean gap of each draw beside the true one, and the share of the draws that come nearest.

    Where the shares of the draws differ because their whole gaps do, those with the true mean gap
    must have the true share.
    """
    open_, closed = (told.columns["controller"] == name for name in ("none", "predictive"))
    gaps = told.columns["residual_gap_deg"][open_].reshape(DRAWS, _PLACES).mean(axis=1)
    shares = (told.columns["interference_mm"][closed] > NEAR_MM).reshape(DRAWS, _PLACES)
    angle = told.columns["motion.reversal_deg"][open_][:_PLACES] * DEG
    off = gaps - float(np.mean(truth.backlash(jnp.asarray(angle)))) / DEG
    nearest = np.argsort(np.abs(off))[:5]
    return {
        "mean_gap_of_the_draws_less_the_true_one_deg": float(off.mean()),
        "std_of_their_mean_gaps_deg": float(off.std(ddof=1)),
        "correlation_of_share_and_mean_gap": float(np.corrcoef(off, shares.mean(axis=1))[0, 1]),
        "mean_gaps_of_the_five_nearest_draws_less_the_true_one_deg": off[nearest].tolist(),
        "share_of_the_five_nearest_draws": float(shares[nearest].mean()),
    }


def _share(table: vttig_jax.SweepTable) -> float:
    return table.to_json()["groups"][0]["interfering_share"]


if __name__ == "__main__":
    main()
