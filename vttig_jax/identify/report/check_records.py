"""Checks and records of a fit in the form of its JSON object."""

from collections.abc import Callable, Sequence

import numpy as np

from ...base.units import ARCSEC, DEG
from ...logs.channel.channel import Channel
from ...logs.channel.spikes import without_spikes
from ...logs.checks.ratio import seen_ratio
from ...logs.encoder_log import EncoderLog
from ...pair.gear_pair import Drive, GearPair
from ..model.column_layout import is_shared
from ..model.mounting import mounting_of
from ..preliminary.alignment import SHAFTS, START
from ..preliminary.linear_fit import LinearFit
from ..preliminary.model_selection import SelectedModel
from ..solve.least_squares import Solution
from .closure import reversal_jumps
from .parameters import Parameter, apparent_gap, variable_backlash_deg
from .repeatability import halves, passes
from .same_rig import disagreements, refuse_different_rigs


def checks_of(
    selected: SelectedModel,
    solution: Solution,
    pair: GearPair | Drive,
    parameters: dict[str, Parameter],
) -> dict:
    """Return name → check, for the checks that need the logs and the solution."""
    linear = selected.linear
    return {
        "reversals": _numbered(
            [
                _reversals(linear, log, solution, pair, parameters)
                for log in range(len(linear.inputs))
            ]
        ),
        "drawing_backlash_deg": _drawing_backlash_deg(pair),
        "ratio": [_ratio(one.log) for one in linear.inputs],
        "agreement": _agreement(linear),
        "apparent_gap": apparent_gap(solution),
        **_drift(selected, solution),
        "outliers": [found.to_json() for found in selected.weights.outliers],
        "weakest_direction": solution.weakest.to_json() if solution.weakest else None,
        "solver_steps": solution.steps,
    }


def repetitions_of(linear: LinearFit) -> dict[str, Callable[[], list[dict]]]:
    """Return name → function that compares passes, or halves of passes, within every log.

    The functions are called later; they keep the block rows but not the samples.
    """
    logs, terms = linear.rows, linear.model.terms
    return {
        "passes": lambda: _numbered([passes([run.curve for run in one.runs]) for one in logs]),
        "halves": lambda: _numbered([halves(one, terms) for one in logs]),
    }


def _numbered(found: Sequence[list[dict]]) -> list[dict]:
    """Return the entries of all logs in one list, each with the number of its log from 1."""
    return [{"log": log, **one} for log, own in enumerate(found, 1) for one in own]


def log_record(linear: LinearFit, solution: Solution, log: int) -> dict:
    """Return the record of one log: file, zero of its angles, start angles, samples per flank."""
    one, rows = linear.inputs[log].log, linear.rows[log]
    used = dict.fromkeys("AB", 0)
    for run in rows.runs:
        used[run.segment.flank] += rows.size * len(run.rows)
    total = sum(used.values())
    return {
        "source": one.source,
        "sha256": one.sha256,
        "zero": one.zero,
        "start": _start(linear, solution, log),
        "zero_readings": {
            shaft: None if channel is None else _zero_reading(channel, one.zero)
            for shaft, channel in (("driving", one.driving), ("driven", one.driven))
        },
        "samples": {
            "read": len(one),
            "used": total,
            "forward": used["A"],
            "backward": used["B"],
            "masked": len(one) - total,
        },
    }


def _zero_reading(channel: Channel, zero: str) -> int | float:
    """Return the reading at which the angle is zero: the first reading, unless it is a spike.

    If the angles are zero at the reading zero, return the first reading, which tells where the log
    started.
    """
    return channel.origin if zero == "start" else channel.reading[0].item()


def _start(linear: LinearFit, solution: Solution, log: int) -> dict[str, float | None]:
    """Return the start angles of a log relative to the first log, degrees, with their std."""
    found: dict[str, float | None] = {}
    for shaft in SHAFTS:
        value, std = getattr(linear.starts[log], shaft), 0.0
        name = f"{START[shaft]}_of_{log + 1}"
        if name in solution.names:
            place = solution.names.index(name)
            value += float(solution.values[place])
            std = float(np.sqrt(solution.covariance[place, place]))
        found |= {f"{shaft}_deg": value / DEG % 360, f"{shaft}_std_deg": std / DEG}
    return found


def _drift(selected: SelectedModel, solution: Solution) -> dict:
    drift = selected.drift
    longest = max(float(c.time[-1] - c.time[0]) for c in selected.linear.channels)
    return {
        "drift_order": drift.order,
        "drift_knots_s": drift.knots_s or None,
        "drift_stiffness_s": drift.stiffness_s(longest),
        "drift_arcsec": [
            float(value) / ARCSEC
            for name, value in zip(solution.names, solution.values, strict=True)
            if name.startswith(("drift_", "spline_"))
        ],
    }


def _reversals(
    linear: LinearFit,
    log: int,
    solution: Solution,
    pair: GearPair | Drive,
    parameters: dict[str, Parameter],
) -> list[dict]:
    """Return every reversal with the constant backlash by the paper's method.

    This backlash is the jump of the transmission error at the reversal minus j_v at the same angle.
    """
    channels, one = linear.channels[log], linear.inputs[log].log
    error = one.transmission_error + float(one.ratio) * (one.driving_angle - channels.driving)
    for name, values in channels.own.items():
        if is_shared(name) and name in solution.names:
            error -= solution.values[solution.names.index(name)] * values
    error = without_spikes(error, one.time, one.spikes)
    jumps = reversal_jumps(channels.driving, error, linear.inputs[log].found.segments)
    if isinstance(pair, GearPair):
        start = _start(linear, solution, log)
        gap = (solution.names, solution.values, [f.flank for f in linear.summary.flanks])
        mounting_deg = mounting_of(*gap, 0.0, log) / DEG
        for jump in jumps:
            driven_deg = float(pair.ratio) * jump["driving_deg"] + mounting_deg
            variable = variable_backlash_deg(
                pair,
                parameters,
                jump["driving_deg"] + (start["driving_deg"] or 0.0),
                driven_deg + (start["driven_deg"] or 0.0),
            )
            jump["variable_backlash_deg"] = variable
            jump["constant_backlash_deg"] = jump["jump_deg"] - variable
    return jumps


def _ratio(log: EncoderLog) -> dict:
    ratio = seen_ratio(log)
    return {
        "given": f"{ratio.given}",
        "seen": ratio.seen,
        "std": ratio.std,
        "verdict": ratio.verdict,
    }


def _agreement(linear: LinearFit) -> list[dict]:
    """Compare the first orders of every log with those of the first log.

    **Raises** `LogError` for logs of different rigs.
    """
    if len(linear.rows) == 1:
        return []
    found = disagreements(
        linear.rows, linear.model.terms, linear.starts, same_zero=linear.model.same_zero
    )
    refuse_different_rigs(found, [one.log.source for one in linear.inputs])
    return found


def _drawing_backlash_deg(pair: GearPair | Drive) -> float | None:
    return None if isinstance(pair, Drive) else float(pair.drawing_backlash) / DEG
