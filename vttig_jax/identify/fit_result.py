"""Result of a fit: parameters, orders, checks, flank model, and the report."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..base.errors import NoAnswerError
from ..base.facade import from_front_door
from ..base.files.text_tables import decimals, key_values, listed, text_table
from ..base.results import PlottedResult
from ..base.units import ARCSEC, DEG, REV
from ..kinematics.flank_error import FlankError
from ..kinematics.flank_model import FlankModel
from ..kinematics.harmonic import OrderModel
from ..kinematics.hunting_coverage import HuntingCoverage
from ..kinematics.te_curve import TECurve
from ..pair.eccentricities import Eccentricities
from ..pair.gear_pair import Drive, Flank, GearPair
from ..pair.schema import HarmonicOrders
from .covered_errors import covered_errors
from .evidence import Evidence
from .log_coverage import log_coverage
from .model.fitted_model import FittedModel, StoredModel
from .noise.noise_model import NoiseModel
from .noise.noise_text import duration_text, noise_rows
from .report.check_sentences import check_sentences, doubt
from .report.checks import Checks
from .report.order_table import Order, judged_orders
from .report.parameters import Outcome, Parameter
from .report.per_log import LogRecord
from .settings import FitSettings


@dataclass(frozen=True)
class FitRequest:
    """Request that led to a fit.

    **Arguments**
    - `settings`: settings of the fit. - `orders`: requested harmonic orders.
    - `reading`: keywords of `read_log` that all logs were read with.
    - `paths`: absolute path of every log; None for arrays.
    """

    settings: FitSettings
    orders: HarmonicOrders
    reading: Mapping[str, Any]
    paths: tuple[Path | None, ...]


@dataclass(frozen=True)
class Fit(PlottedResult):
    """Result of the identification of a gear pair or drive from its logs.

    **Arguments**
    - `parameters`: name → `Parameter`, for every parameter of schema `vttig.fit/1`.
    - `orders`: every fitted harmonic of each flank.
    - `model`: order-complete flank model in the absolute angles that the encoders read, encoder
      errors included.
    - `given`: in a fit with `model=`, the sum of that model with its fitted parameters,
      `given.fitted`, and of `model`, which then holds offsets and free orders; otherwise None.
    - `curves`: transmission error of every run as block means. - `residuals`: their residuals, rad.
    - `noise`: noise model of the block means. - `residual_rms_deg`: rms residual of single samples.
    - `covariance`, `covariance_names`: covariance and names of the Cartesian parameters, mm and
      rad.
    - `checks`: closure, reversal jumps, order amplitudes, ratio, drift; see `Checks`. The search
      for lines and the comparisons within each log are computed when they are first read.
    - `warnings`: sentences on what changes a stated number or what the user must do.
    - `notes`: these sentences, then conditions of the numbers, then details of the logs.
    - `regressors`: fitted coefficients of torque, acceleration, speed and ratio.
    - `logs`: file, digest, zero and samples of every log.
    - `evidence`: compressed logs, from which `sample` computes the likelihood.
    - `request`: settings and orders of the fit; None for a fit from `read_fit`.
    """

    pair: GearPair | Drive
    source: str
    sha256: str
    outcome: Outcome
    flanks: tuple[str, ...]
    samples: dict[str, int]
    zero: str
    zero_readings: dict[str, float | int | None]
    conditional_on: tuple[str, ...]
    parameters: dict[str, Parameter]
    orders: tuple[Order, ...]
    model: OrderModel
    noise: NoiseModel
    residual_rms_deg: float
    curves: tuple[TECurve, ...]
    residuals: tuple[Float[np.ndarray, " _"], ...]
    covariance: Float[np.ndarray, "p p"]
    covariance_names: tuple[str, ...]
    values: Float[np.ndarray, " p"]
    checks: Checks
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    regressors: tuple[Parameter, ...] = ()
    logs: tuple[LogRecord, ...] = ()
    evidence: Evidence | None = None
    request: FitRequest | None = None
    given: FittedModel | StoredModel | None = None

    def judged_orders(self) -> tuple[Order, ...]:
        """Return the orders; one that a line of the residual explains is marked not significant."""
        turns = max((float(np.ptp(curve.driving_angle)) / REV for curve in self.curves), default=0)
        return judged_orders(self.orders, self.checks.lines, float(self.pair.ratio), turns)

    @property
    def flank_model(self) -> FlankModel:
        """The whole flank model of the fit: `given`, or `model` of a fit of the exact relation."""
        return self.model if self.given is None else self.given

    @cached_property
    def coverage(self) -> HuntingCoverage:
        """Part of the hunting period that the logs cover."""
        return log_coverage(self.curves, self.logs, self.pair)

    @cached_property
    def flank_errors(self) -> dict[Flank, FlankError]:
        """Size of the fitted transmission error of each measured flank over the covered angles.

        Fractional orders are part of it; drift and regressors are not.
        """
        return covered_errors(self.flank_model, self.orders, self.coverage)

    def value(self, name: str) -> float:
        """Return the value of a parameter; NaN if it has none."""
        value = self.parameters[name].value
        return float("nan") if value is None else value

    def eccentricities(self, constant_backlash_deg: float | None = None) -> Eccentricities:
        """Return the fitted rig; an undetermined eccentricity counts as zero.

        `constant_backlash_deg` replaces the fitted value.

        **Raises** `NoAnswerError` for a fit of a given flank model, which has no eccentricities.
        """
        _require_relation(self)
        cartesian = dict(zip(self.covariance_names, self.values, strict=True))
        driving, driven = (
            complex(cartesian[f"{shaft}_x"], cartesian[f"{shaft}_y"])
            if self.parameters[f"{shaft}_eccentricity_mm"].determined
            else 0.0
            for shaft in ("driving", "driven")
        )
        if constant_backlash_deg is None:
            constant_backlash_deg = cartesian.get("constant_backlash", 0.0) / DEG
        return Eccentricities(
            abs(driving),
            np.angle(driving, deg=True),
            abs(driven),
            np.angle(driven, deg=True),
            constant_backlash_deg,
        )

    def save(self, folder: str | Path, *, overwrite: bool = False, figures: bool = True) -> None:
        """Write a run folder, as `vttig fit --out` does; see `vttig_jax.runs.save_fit`."""
        from_front_door("save_fit")(self, folder, overwrite=overwrite, figures=figures)

    def to_json(self) -> dict:
        """Return the object of schema `vttig.fit/1`."""
        return {
            "schema": "vttig.fit/1",
            "outcome": self.outcome,
            "source": self.source,
            "sha256": self.sha256,
            "pair": self.pair.name,
            **({} if self.given is None else {"flank_model": self.given.name}),
            "flanks": list(self.flanks),
            "samples": self.samples,
            "zero": self.zero,
            "zero_readings": self.zero_readings,
            "conditional_on": list(self.conditional_on),
            "noise": self.noise.to_json(),
            "residual_rms_deg": self.residual_rms_deg,
            "transmission_error": {
                flank: error.to_json() for flank, error in self.flank_errors.items()
            },
            "parameters": {name: p.to_json() for name, p in self.parameters.items()},
            "regressors": {p.name: p.to_json() for p in self.regressors},
            "orders": [order.to_json() for order in self.judged_orders()],
            "logs": [log.to_json() for log in self.logs],
            "checks": self.checks.to_json(),
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        return fit_text(self)


def _require_relation(fit: Fit) -> None:
    """Raise `NoAnswerError` for a fit of a given flank model, which fits no eccentricities."""
    if fit.given is not None:
        raise NoAnswerError(
            f"a fit of the flank model {fit.given.name} has no eccentricities; fit without"
            " `model` for a rig.",
            where=fit.source,
        )


def require_rig(fit: Fit) -> None:
    """Raise `NoAnswerError` if a fit does not determine a rig that can be simulated.

    This is the case for a drive without gears, for a given flank model, and without a determined
    constant backlash.
    """
    _require_relation(fit)
    if isinstance(fit.pair, Drive):
        raise NoAnswerError(
            "a drive without gear geometry has no eccentricities to simulate; give [pair].",
            where=fit.source,
        )
    gap = fit.parameters["constant_backlash_deg"]
    if not gap.determined:
        raise NoAnswerError(
            f"the constant backlash is undetermined ({gap.reason}), so that there is no gap to"
            " simulate; record both directions.",
            where=fit.source,
        )


_CLEAR, _MOST_ORDERS = 4.0, 8
"""Standard errors above which a further order is printed, and the most orders printed."""

_UNKNOWN_DEG = 60.0
"""Standard error of a start angle, deg, above which the report calls it unknown."""

_ZEROS = {"start": "the first sample", "reading": "where the channel reads zero"}


def fit_text(fit: "Fit") -> str:
    """Return the report of a fit, from its logs to the notes."""
    shown = [p for p in (*fit.parameters.values(), *fit.regressors) if p.determined]
    rms = fit.residual_rms_deg
    head = key_values(
        [
            *(("log", one.source) for one in fit.logs[1:] and fit.logs),
            *([] if fit.logs[1:] else [("log", fit.source)]),
            ("outcome", fit.outcome.replace("_", " ")),
            *([] if fit.given is None else [("flank model", fit.given.name)]),
            ("flanks", " and ".join(fit.flanks)),
            ("samples", _samples(fit.samples)),
            ("zero of both angles", _ZEROS[fit.zero]),
            *_starts(fit.logs),
            ("residual", f"{rms:.5f}° rms ({rms * DEG / ARCSEC:.2f}″)"),
            *_flank_errors(fit),
            *noise_rows(fit.noise, _longest_s(fit.curves)),
            ("drift", _drift(fit.checks)),
        ],
        title=fit.pair.name or "fit",
    )
    table = text_table(
        [_row(p) for p in shown], ["parameter", "value", "std", "95 % interval", "unit"]
    )
    parts = [head, *_with_errors("warnings", list(fit.warnings)), *([table] if shown else [])]
    parts += _orders(fit.judged_orders())
    if fit.conditional_on:
        parts.append("conditional on: " + ", ".join(fit.conditional_on).replace("_", " "))
    parts += listed("undetermined", _open_reasons(fit))
    sentences = check_sentences(
        fit.checks,
        several_logs=len(fit.logs) > 1,
        has_noise=not fit.noise.is_rounding,
        gap_determined=fit.parameters["constant_backlash_deg"].determined,
    )
    parts += _with_errors("checks", sentences)
    parts += _with_errors("notes", [note for note in fit.notes if note not in fit.warnings])
    return "\n\n".join(parts)


def _flank_errors(fit: "Fit") -> list[tuple[str, str]]:
    """Return the report rows (label, text) of the transmission error of each measured flank."""
    turns = f"{fit.pair.hunting_turns} driving turns"
    return [
        (f"error of flank {flank}", f"{error}, over {error.turns:.3g} of {turns}")
        for flank, error in fit.flank_errors.items()
    ]


def _with_errors(title: str, sentences: list[str]) -> list[str]:
    """Return a list of sentences whose title says what ± means, if a sentence has ` ± `."""
    meaning = " (± is one standard error)" if any(" ± " in one for one in sentences) else ""
    return listed(title + meaning, sentences)


def _longest_s(curves: tuple[TECurve, ...]) -> float:
    """Return the time from the first to the last row of the runs; the longest of several logs."""
    spans = [(c.time[0], c.time[-1]) for c in curves if len(c)]
    return max((end for _, end in spans), default=0.0) - min((t for t, _ in spans), default=0.0)


def _open_reasons(fit: "Fit") -> list[str]:
    """Return lines with undetermined parameters and the reason.

    Parameters with the same reason share a line.
    """
    together: dict[str, list[str]] = {}
    for parameter in (*fit.parameters.values(), *fit.regressors):
        if not parameter.determined:
            together.setdefault(parameter.reason or "", []).append(parameter.name)
    return [f"{', '.join(names)}: {reason}" for reason, names in together.items()]


def _orders(orders: tuple[Order, ...]) -> list[str]:
    """Return the table of the clear further orders, with one column per flank.

    The order with the largest amplitude is first; the list is empty if no order is clear.
    """
    found: dict[tuple[str, int | float], dict[str, Order]] = {}
    for one in orders:
        if one.order != 1 or one.shaft == "mesh":
            found.setdefault((one.shaft, one.order), {})[one.flank] = one
    clear = [
        (name, flanks)
        for name, flanks in found.items()
        if any(
            o.significant and o.amplitude_arcsec > _CLEAR * o.std_arcsec for o in flanks.values()
        )
    ]
    clear.sort(key=lambda item: -max(o.amplitude_arcsec for o in item[1].values()))
    if not clear:
        return []
    rows = [
        [f"{shaft} {order}", *(_amplitude(flanks.get(flank)) for flank in ("A", "B"))]
        for (shaft, order), flanks in clear[:_MOST_ORDERS]
    ]
    table = text_table(rows, ["further orders", "flank A [″]", "flank B [″]"])
    left = len(clear) - _MOST_ORDERS
    return [table + (f"\n… and {left} more in fit.json" if left > 0 else "")]


def _amplitude(order: Order | None) -> str:
    return "" if order is None else f"{order.amplitude_arcsec:.3g} ± {order.std_arcsec:.2g}"


def _starts(logs: tuple[LogRecord, ...]) -> list[tuple[str, str]]:
    """Return the report rows (label, text) of the logs with fitted start angles."""
    starts = [(number, log.start) for number, log in enumerate(logs[1:], 2)]
    return [
        (
            f"start of log {number}",
            _start("driving", start.driving_deg, start.driving_std_deg)
            + ", "
            + _start("driven", start.driven_deg, start.driven_std_deg),
        )
        for number, start in starts
        if start.driving_std_deg != 0
    ]


def _start(shaft: str, value: float | None, std: float | None) -> str:
    if value is None or std is None or not 0 < std < _UNKNOWN_DEG:
        return f"{shaft} unknown"
    return f"{shaft} {value:.3f}° ± {std:.2g}°"


def _samples(samples: dict[str, int]) -> str:
    return (
        f"{samples['read']} read, {samples['used']} used ({samples['forward']} forward,"
        f" {samples['backward']} backward)"
    )


_POWERS = {1: "straight line in time", 2: "parabola in time"}


def _drift(checks: Checks) -> str:
    if checks.drift_knots_s:
        what = f"cubic spline with knots every {duration_text(checks.drift_knots_s)}"
    elif checks.drift_order:
        what = _POWERS.get(checks.drift_order, f"polynomial of degree {checks.drift_order} in time")
    else:
        return "none"
    stiffness = checks.drift_stiffness_s
    return what + (f", follows nothing faster than {duration_text(stiffness)}" if stiffness else "")


def _row(parameter: Parameter) -> list[str]:
    p = parameter
    if p.value is None:
        return [p.name, "—", "", "", p.unit]
    places = decimals(p.std or 0.0, p.value)
    number = lambda x: f"{x:z.{places}f}"  # noqa: E731
    if p.upper95 is not None:
        return [p.name, f"< {number(p.upper95)}", number(p.std), "upper limit", p.unit]
    span = f"{number(p.low95)} … {number(p.high95)}"
    unlike = " (as given)" if p.name == "ratio" else doubt(p.value, p.low95, p.high95, p.reason)
    mark = "" if p.significant else unlike
    return [p.name, number(p.value) + mark, number(p.std), span, p.unit]
