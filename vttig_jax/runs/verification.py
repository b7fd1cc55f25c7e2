"""What a log of an axis against its command says about the compensation of the axis."""

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import msgspec
import numpy as np

from ..base.errors import NoAnswerError, UsageError
from ..base.units import ARCSEC, REV
from ..control.compensation.correction import CorrectionTable, left_over
from ..control.compensation.verification import FAULTS, AxisRows, judged, size_of
from ..identify.identification import fit as fit_log
from ..logs.encoder_log import EncoderLog
from ..logs.readers.column_names import default_column
from ..logs.readers.open_table import open_table
from ..logs.recognition.assign import assign
from ..logs.recognition.request import ReadingOptions, Statement, stated_layout
from ..model.columns import embedding
from ..model.density import LAGS, weights
from ..model.mixed_fit import residuals
from ..pair.gear_pair import Flank
from ..pair.schema import Encoder, PairSpec
from ..posterior.summary.posterior import Posterior
from .axis_table import AxisCurves, AxisSetting, axis_curves, axis_table
from .run import Run

_NUISANCE = ("delay", "ratio", "torque", "drift", "part", "bend")
"""Columns of a fit that are no error of the axis."""

_PLACES, _SAMPLES = 400, 4
"""Rows at which sizes are computed, and samples of a row at which curves are averaged (chosen)."""


def verify(
    run: Run,
    logs: Sequence[Path],
    axis: AxisSetting = AxisSetting(),
    step_deg: float | None = None,
    reading: ReadingOptions = ReadingOptions(),
    posterior: Posterior | None = None,
) -> dict[str, Any]:
    """Return what logs of an axis against its command say about its table, `vttig.verify/1`.

    **Arguments**
    - `run`: run folder that the table was exported from. - `logs`: one log, or before and after.
    - `axis`, `step_deg`: what the table was exported with. - `reading`: how the logs are read.
    - `posterior`: draws of the run, which say what it leaves open; by default its Student's t.

    **Raises** `NoAnswerError` for a log without the command, and the errors of `axis_table`.
    """
    curves = axis_curves(run.fit, posterior, axis)
    table = axis_table(run.fit, posterior, axis, step_deg).table
    gain = Fraction(run.pair.ratio if axis.shaft == "driven" else 1) * (-1 if axis.reversed else 1)
    read = [commanded_log(path, run.record.spec, gain, reading) for path in logs]
    checks = [_checked(run, log, curves, table) for log in read]
    names = [name for name in checks[0]["left_arcsec"] if name in checks[-1]["left_arcsec"]]
    change = {name: _change(name, *checks) for name in names if len(checks) > 1}
    ends = np.degrees(table.positions[[0, -1]]).tolist()
    return {"schema": "vttig.verify/1", "table_deg": ends, "logs": checks, "change": change}


def _change(name: str, before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Return whether a direction is "better", "worse" or "open" in the log after a change.

    If it is open, `needed_s` is the length of a log that tells in 80 of 100 cases what the table
    should change: the error s of a change d has to be d/2.8.
    """
    first, second = (one["left_arcsec"][name] for one in (before, after))
    change = second["rms"] ** 2 - first["rms"] ** 2
    spread = np.hypot(*((one["high95"] ** 2 - one["rms"] ** 2) / 1.96 for one in (first, second)))
    if abs(change) > 1.96 * spread:
        return {"outcome": "better" if change < 0 else "worse", "needed_s": None}
    far = max(abs(end**2 - first["rms"] ** 2) for end in second["predicted95"])
    return {"outcome": "open", "needed_s": after["span_s"] * float(2.8 * spread / far) ** 2}


def commanded_log(
    path: Path, spec: PairSpec, gain: Fraction, reading: ReadingOptions
) -> EncoderLog:
    """Return a log of the driven shaft against the command of its axis.

    The command takes the place of the driving shaft, at φ₁ = command / `gain`.
    """
    layout = stated_layout(spec.log, reading)
    table = open_table(path, layout)
    index = default_column("command", table.names, table.source)
    name = layout.command or (None if index is None else table.names[index])
    if name is None:
        raise NoAnswerError(
            "the log does not have the commanded position, and two encoders alone do not see a"
            " compensation; log the command too, and name its column with --column command=NAME.",
            where=str(path),
        )
    given = {"driving": name, "driving_scale": str(1 / abs(gain)), "zero": "reading"}
    unused = {"command": None, "driving_rpm": None, "driving_increments": False}
    statement = Statement(
        msgspec.structs.replace(layout, **given, **unused),
        msgspec.structs.replace(spec.unit, driving=spec.unit.command),
        (Encoder(sign=1 if gain > 0 else -1), spec.driven.encoder),
        spec.ratio,
        in_file=True,
    )
    roles = assign(table, statement)
    for question in roles.questions:
        raise question
    log = EncoderLog.of(table, roles)
    if np.cov(log.driving.angle, log.driven_angle)[0, 1] < 0:
        raise UsageError(
            "the axis counts against its command; give --reversed here and to export, or take it"
            " away if it is given; or fit again with the other shaft inverted.",
            where=str(path),
        )
    return log


def _checked(
    run: Run, log: EncoderLog, curves: AxisCurves, table: CorrectionTable
) -> dict[str, Any]:
    """Return what one log shows beside the table, from the fit of its error."""
    error, settings = curves.error, run.record.options.settings
    only = None if len(error.errors) > 1 else next(iter(error.errors))
    changes = {"ratio_within": 0.0, "lines": "report", "same_zero": None, "flank": only}
    settings = msgspec.structs.replace(settings, **changes)
    core = fit_log(log, run.pair, settings=settings, orders=run.record.spec.fit).core
    problem, (rows,), (shafts,) = core.posterior.problem, core.rows, core.shafts
    unit, flank = error.gain / error.ratio, rows.flank
    names: dict[Flank, str] = {
        one: name for name, one in error.directions.items() if np.any(flank == one)
    }
    few = ((np.arange(_SAMPLES) + 0.5) * rows.samples.shape[1] / _SAMPLES).astype(int)
    command, picked = error.gain * shafts.driving, rows.samples[:, few]

    where, left = command[picked].mean(axis=1), np.zeros(())
    for one, name in names.items():
        predicted = left_over(curves.drawn, table, name, where)
        left = np.where((flank == one)[:, None], predicted, left)
    off = left[0] - left[0].mean(axis=1, keepdims=True)
    zeros = [np.ones(len(flank))] if curves.has_gap else [flank == one for one in names]
    nuisance = np.array([column.row.kind in _NUISANCE for column in problem.columns])
    (shown,) = residuals(problem.columns, core.rows, core.posterior.coefficients * nuisance)
    weight = np.asarray(weights(jnp.asarray(core.posterior.theta), problem.compressed.on))[
        : LAGS + 1
    ]
    taps = weight / np.sqrt(weight[0]) / (problem.unit * abs(unit))
    links = [embedding(problem.columns, rows.names, 0, one)[:, :-1] for one in ("A", "B")]
    columns = np.where((flank == "A")[:, None], *(rows.table @ link for link in links))
    # The log has no drift but for its noise, if a curve explains what the fit took for one.
    loose = columns[:, nuisance] / np.maximum(np.max(np.abs(columns[:, nuisance]), axis=0), 1e-300)
    open_ = np.column_stack([off / np.sqrt(off.shape[1]), *zeros, loose])
    orders = columns[:, ~nuisance]
    measured = AxisRows(
        rows, shafts.time, command, picked, flank, unit * shown, taps, open_, orders
    )
    # Curves are looked up: a search takes them at a thousand places for each row.
    period = run.pair.hunting_turns * REV
    count = min(64 * run.pair.hunting_turns * math.ceil(run.fit.model.highest_order), 2**18)
    angle = np.arange(count) * (period / count)
    looked = {
        one: partial(np.interp, xp=angle, fp=curve(angle), period=period)
        for one, curve in error.errors.items()
    }
    verdict = judged(replace(error, errors=looked), table, measured, curves.turns)

    thin = slice(None, None, -(-len(flank) // _PLACES))
    on: dict[Flank, np.ndarray] = {one: flank[thin] == one for one in names}
    ahead = (flank[thin] == "A")[:, None]

    def centred(values: np.ndarray) -> np.ndarray:
        levels = {one: values[own].mean(axis=0) for one, own in on.items()}
        if curves.has_gap:
            levels = dict.fromkeys(on, np.mean(list(levels.values()), axis=0))
        return values - np.where(ahead, levels.get("A", 0.0), levels.get("B", 0.0))

    design = unit * centred(np.where(nuisance, 0.0, columns[thin]))
    mean, covariance, _ = core.posterior.told(design)
    # What the table leaves is seen at the orders of the fit, as what is measured.
    seen = [np.linalg.lstsq(design, centred(turn[thin]), rcond=1e-9)[0] for turn in left]
    record = {}
    for one, own in on.items():
        sizes = size_of(mean[own], covariance[np.ix_(own, own)]) / ARCSEC
        rms = np.sqrt([np.mean((design[own] @ turn) ** 2, axis=0) for turn in seen])
        ends = np.quantile(rms, [0.025, 0.975])
        record[names[one]] = {
            **dict(zip(("rms", "low95", "high95"), sizes.tolist(), strict=True)),
            "predicted95": (ends / ARCSEC).tolist(),
        }
    (first, *others), value, ratio = verdict
    # The likeliest table may leave more than its prediction, as after a change of the load.
    ends = [(one["low95"], one["high95"], *one["predicted95"]) for one in record.values()]
    if first == "right" and not all(
        low <= most and least <= high for low, high, least, most in ends
    ):
        first, others = "changed", []
    said = FAULTS.get(first, "the table works as predicted")
    said = said.format(value, zero_deg=np.degrees(error.zero) + (value or 0.0))
    return {
        "source": log.source,
        "span_s": float(np.ptp(log.time)),
        "travel_deg": np.degrees([command[picked].min(), command[picked].max()]).tolist(),
        "left_arcsec": record,
        "likely": first,
        "value": value,
        "log_ratio": ratio,
        "not_excluded": others,
        "sentence": said + f"; not excluded: {', '.join(others)}" * bool(others),
    }
