"""Result of a fit: parameters, orders, flank model, checks and findings, and its report."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..base.errors import NoAnswerError
from ..base.facade import from_front_door
from ..base.files.text_tables import decimals, key_values, listed, text_table
from ..base.results import PlottedResult
from ..base.units import ARCSEC, DEG, REV, duration_text
from ..kinematics.flank_error import FlankError, errors_at, flank_error
from ..kinematics.flank_model import FlankModel
from ..kinematics.harmonic import OrderModel
from ..kinematics.hunting_coverage import HuntingCoverage, hunting_coverage
from ..kinematics.te_curve import TECurve
from ..model.mixed_fit import MixedFit
from ..model.parameter import Parameter, open_reasons
from ..pair.gear_pair import Drive, Eccentricities, GearPair
from ..pair.schema import Flank, HarmonicOrders
from .accuracy import Accuracy, accuracy_of
from .fit_settings import FitSettings
from .given import FittedModel, StoredModel
from .orders import Order, exceeds_noise, is_fractional
from .records import Checks, Finding, LogRecord, LogStart, Noise, Outcome
from .turn_averages import Measured, measured


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


@dataclass(frozen=True, repr=False)
class Fit(PlottedResult):
    """Result of the identification of a gear pair or drive from its logs.

    **Arguments**
    - `parameters`: name → `Parameter`, for every parameter of schema `vttig.fit/1`.
    - `orders`: every fitted harmonic of each flank.
    - `model`: order-complete flank model in the absolute angles that the encoders read, encoder
      errors included.
    - `curves`: transmission error of every run as rows of averaged samples, without the delay.
    - `residuals`: their residuals, rad. - `residual_rms_deg`: rms of all of them.
    - `noise`: noise of the rows.
    - `covariance`, `covariance_names`, `values`: of the Cartesian parameters, mm, rad and s.
    - `checks`: gap over the angles covered and at several speeds, lines, drift, …; see `Checks`.
    - `findings`: everything that the fit has to say, a record each, warnings first.
    - `regressors`: coefficient of the torque, and ratio of a drive.
    - `logs`: file, digest, zero and samples of every log.
    - `given`: in a fit with `model=`, the sum of that model with its fitted parameters,
      `given.fitted`, and of `model`, which then holds offsets and free orders; otherwise None.
    - `core`: the fitted mixed model, from which sampling goes on; without its rows and samples in a
      fit from `read_fit`.
    - `request`: settings and orders of the fit; None for a fit from `read_fit`.
    - `stored`: in a fit from `read_fit`, what its folder keeps of the samples.
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
    noise: Noise
    residual_rms_deg: float
    curves: tuple[TECurve, ...]
    residuals: tuple[Float[np.ndarray, " _"], ...]
    covariance: Float[np.ndarray, "p p"]
    covariance_names: tuple[str, ...]
    values: Float[np.ndarray, " p"]
    checks: Checks
    findings: tuple[Finding, ...]
    core: MixedFit
    regressors: tuple[Parameter, ...] = ()
    logs: tuple[LogRecord, ...] = ()
    request: FitRequest | None = None
    given: FittedModel | StoredModel | None = None
    stored: Measured | None = None

    @property
    def flank_model(self) -> FlankModel:
        """The whole flank model of the fit: `given`, or `model` of a fit of the exact relation."""
        return self.model if self.given is None else self.given

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on what changes a stated number or its meaning, with what to do."""
        return tuple(one.text for one in self.findings if one.severity != "note")

    @property
    def notes(self) -> tuple[str, ...]:
        """All sentences of the findings, the warnings first."""
        return tuple(one.text for one in self.findings)

    @property
    def open_reasons(self) -> list[str]:
        """Lines with undetermined parameters and the reason, which several may share."""
        return open_reasons((*self.parameters.values(), *self.regressors))

    @cached_property
    def coverage(self) -> HuntingCoverage:
        """Part of the hunting period that the logs cover: driving angles.

        The curves of the first log have the zero of the map. A further log with a zero of its own
        has start angles a₁ and a₂ that are known up to whole turns of their shafts. It lies in the
        turn k of the driving shaft for which i (a₁ + 2πk) is closest to a₂ modulo 2π. Where the
        start angles are too uncertain to separate neighbouring turns, the curves of this log are
        not placed.

        **Example**
        ```python
        >>> import vttig_jax
        >>> from vttig_jax.rig import paper_rig
        >>> vttig_jax.enable_x64()
        >>> rig = paper_rig()
        >>> print(vttig_jax.fit(rig.log(), rig.pair).coverage)
        all 16 driving turns of the hunting period on both flanks

        ```
        """
        curves = self.curves
        places = [_place(log.start, self.pair) for log in self.logs] or [0.0]
        # The time of every log starts again.
        again = [later.time[0] < earlier.time[-1] for earlier, later in pairwise(curves)]
        if curves and sum(again) + 1 == len(places):
            numbers = np.cumsum([0, *again]).tolist()
            return hunting_coverage(curves, self.pair, [places[number] for number in numbers])
        # It is unknown which curve belongs to which log, but logs with a common zero need no place.
        common = 0.0 if all(place == 0.0 for place in places) else None
        return hunting_coverage(curves, self.pair, [common] * len(curves))

    @cached_property
    def flank_errors(self) -> dict[Flank, FlankError]:
        """Size of the fitted transmission error of each measured flank over the covered angles.

        Fractional orders are part of it, with the phases of the first log; drift and regressors are
        not. A `StoredModel` has the sizes that its fit has stored.
        """
        model, found = self.flank_model, dict[Flank, FlankError]()
        if isinstance(model, StoredModel):
            return dict(model.errors)
        highest = max([model.highest_order, *(float(one.order) for one in self.orders)])
        for flank, spans in self.coverage.spans.items():
            own = [one for one in self.orders if one.flank == flank]
            size = flank_error(partial(_error, model, flank, own), spans, highest)
            significant = isinstance(model, FittedModel) or exceeds_noise(own)
            found[flank] = replace(size, significant=significant)
        return found

    @cached_property
    def measured(self) -> Measured | None:
        """What the samples tell beside the fit: harmonics of turns, and readings at targets."""
        if self.stored is not None or self.given is not None:
            return self.stored
        return measured(self.core, self.pair, self.orders)

    @cached_property
    def accuracy(self) -> Accuracy:
        """Accuracy in the terms of ISO 1328-1 and ISO 230-2, as `vttig accuracy` prints it.

        **Raises** `NoAnswerError` where the log does not tell it.
        """
        return accuracy_of(self.measured, self.pair, self.source)

    def value(self, name: str) -> float:
        """Return the value of a parameter; NaN if it has none.

        **Raises** `KeyError` that lists the names, for a name that is no parameter.
        """
        if name not in self.parameters:
            raise KeyError(f"no parameter {name!r}; there are {', '.join(self.parameters)}.")
        value = self.parameters[name].value
        return float("nan") if value is None else value

    def mounting(self, constant_backlash_rad: float) -> float:
        """Return the angle m of φ₂ = i φ₁ + m + TE_A, rad: the offset of flank A.

        If flank B alone was measured, it is its offset less the constant backlash.
        """
        offset = np.asarray(self.model.offset)
        return float(offset[1] - constant_backlash_rad if self.flanks == ("B",) else offset[0])

    def eccentricities(self, constant_backlash_deg: float | None = None) -> Eccentricities:
        """Return the fitted rig; an undetermined eccentricity counts as zero.

        `constant_backlash_deg` replaces the fitted value.

        **Raises** `NoAnswerError` for a fit of a given flank model, which has no eccentricities.
        """
        _require_relation(self)
        cartesian = dict(zip(self.covariance_names, self.values, strict=True))
        polar: dict[str, Any] = {}
        for shaft in ("driving", "driven"):
            offset = complex(0.0)
            if self.parameters[f"{shaft}_eccentricity_mm"].determined:
                offset = complex(cartesian[f"{shaft}_x"], cartesian[f"{shaft}_y"])
            polar[f"{shaft}_mm"] = abs(offset)
            polar[f"{shaft}_phase_deg"] = np.angle(offset, deg=True)
        if constant_backlash_deg is None:
            constant_backlash_deg = cartesian.get("constant_backlash", 0.0) / DEG
        return Eccentricities(**polar, constant_backlash_deg=constant_backlash_deg)

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
            "orders": [order.to_json() for order in self.orders],
            "logs": [log.to_json() for log in self.logs],
            "checks": self.checks.to_json(),
            "findings": [one.to_json() for one in self.findings],
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        return fit_text(self)

    __repr__ = __str__


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
    refuse_unknown_gap(fit, covered=False)


def refuse_unknown_gap(fit: Fit, *, covered: bool = True) -> None:
    """Raise `NoAnswerError` if a fit tells neither the constant gap nor, if `covered`, that of
    some angles.
    """
    gap = fit.parameters["constant_backlash_deg"]
    if gap.determined or (covered and fit.checks.gap_over_angles_covered.determined):
        return
    cure = "record more turns."
    if len(fit.flanks) != 2:
        cure = (
            "record both directions, or give the constant backlash measured in another way"
            " (--constant-backlash-deg)."
        )
    raise NoAnswerError(
        f"the constant backlash is undetermined ({gap.reason}); {cure}", where=fit.source
    )


_CLEAR, _MOST_ORDERS = 4.0, 8
_UNKNOWN_DEG = 60.0
_ZEROS = {"start": "the first sample", "reading": "where the channel reads zero"}


PARAMETER_HEADERS = ("parameter", "value", "std", "ν", "95 % interval", "unit")
"""Titles of the columns of `parameter_cells`."""


def fit_text(fit: Fit) -> str:
    """Return the report of a fit, from its logs to the notes."""
    shown = [p for p in (*fit.parameters.values(), *fit.regressors) if p.determined]
    rms, noise, samples = fit.residual_rms_deg, fit.noise, fit.samples
    drift = fit.checks.drift_arcsec if fit.checks.likelihood_ratio.get("drift", 0.0) > 0 else 0.0
    rows = [("log", one.source) for one in (fit.logs if fit.logs[1:] else (fit,))]
    rows.append(("outcome", fit.outcome.replace("_", " ")))
    if fit.given is not None:
        rows.append(("flank model", fit.given.name))
    used = f"{samples['used']} used ({samples['forward']} forward, {samples['backward']} backward)"
    rows += [("flanks", " and ".join(fit.flanks)), ("samples", f"{samples['read']} read, {used}")]
    rows += [("zero of both angles", _ZEROS[fit.zero]), *_starts(fit.logs)]
    rows.append(("residual", f"{rms:.5f}° rms ({rms * DEG / ARCSEC:.2f}″) of averaged rows"))
    for flank, error in fit.flank_errors.items():
        turns = f"{error.turns:.3g} of {fit.pair.hunting_turns} driving turns"
        rows.append((f"error of flank {flank}", f"{error}, over {turns}"))
    memory = f"correlation time {duration_text(noise.correlation_s)}"
    memory += f", {100 * noise.slow_share:.0f} % of its variance is slow"
    rows.append(("noise", f"rows of {duration_text(noise.block_s)}, {memory}"))
    rows.append(("drift", f"{drift:.2g}″" if drift >= 0.005 else "none"))
    head = key_values(rows, title=fit.pair.name or "fit")
    table = text_table([parameter_cells(p) for p in shown], PARAMETER_HEADERS)
    parts = [head, *_titled("warnings", list(fit.warnings)), *([table] if shown else [])]
    parts += [*_orders(fit), *conditions(fit.conditional_on)]
    parts += listed("undetermined", fit.open_reasons)
    parts += _titled("notes", [one.text for one in fit.findings if one.severity == "note"])
    return "\n\n".join(parts)


def conditions(names: Sequence[str]) -> list[str]:
    """Return a list with one text on what a result is conditional on; empty without conditions."""
    return [f"conditional on: {', '.join(names)}".replace("_", " ")] if names else []


def _titled(title: str, sentences: list[str]) -> list[str]:
    """Return a list of sentences whose title says what ± means, if a sentence has ` ± `."""
    meaning = " (± is one standard error)" if any(" ± " in one for one in sentences) else ""
    return listed(title + meaning, sentences)


def _orders(fit: Fit) -> list[str]:
    """Return the table of the clear orders, with one column per flank, the first orders first."""
    found: dict[tuple[str, int | float], dict[str, Order]] = {}
    for one in fit.orders:
        found.setdefault((one.shaft, one.order), {})[one.flank] = one
    first = [item for item in found.items() if item[0][1] == 1 and item[0][0] != "mesh"]
    clear = [
        item
        for item in found.items()
        if item not in first
        and any(o.amplitude_arcsec > _CLEAR * o.std_arcsec for o in item[1].values())
    ]
    clear.sort(key=lambda item: -max(o.amplitude_arcsec for o in item[1].values()))
    rows = [
        [f"{shaft} {order}", *(str(flanks.get(flank, "")) for flank in ("A", "B"))]
        for (shaft, order), flanks in (*first, *clear[:_MOST_ORDERS])
    ]
    if not rows:
        return []
    table = text_table(rows, ["order", "flank A [″]", "flank B [″]"])
    left = len(clear) - _MOST_ORDERS
    return [table + (f"\n… and {left} more in fit.json" if left > 0 else "")]


def _starts(logs: tuple[LogRecord, ...]) -> list[tuple[str, str]]:
    """Return the report rows (label, text) of the logs with start angles of their own."""

    def angle(shaft: str, value: float | None, std: float | None) -> str:
        if value is None or std is None or std > _UNKNOWN_DEG:
            return f"{shaft} unknown (no order that both logs share tells it)"
        return f"{shaft} {value:.3f}° ± {std:.2g}°"

    rows = []
    for number, start in enumerate((log.start for log in logs[1:]), 2):
        if start.driving_std_deg != 0:
            driving = angle("driving", start.driving_deg, start.driving_std_deg)
            driven = angle("driven", start.driven_deg, start.driven_std_deg)
            rows.append((f"start of log {number}", f"{driving}, {driven}"))
    return rows


def doubt(
    value: float | None, low95: float | None, high95: float | None, reason: str | None = None
) -> str:
    """Return a remark in brackets that says why a value is not significant.

    If the interval does not contain zero, the remark states the rule of the `reason`.

    **Example**
    ```python
    >>> from vttig_jax.identify.result import doubt
    >>> doubt(-0.5, -1.2, 0.2, "below three standard errors")
    ' (not significant)'
    >>> doubt(-0.5, -0.52, -0.48)
    ' (below zero)'

    ```
    """
    if value is None or low95 is None or high95 is None or low95 <= 0 <= high95:
        return " (not significant)"
    if reason is not None and reason.startswith("below"):
        return f" ({reason.partition(';')[0]})"
    return " (below zero)" if value < 0 else " (not significant)"


def parameter_cells(p: Parameter) -> list[str]:
    """Return name, value, standard error, ν, interval and unit of a parameter as text."""
    if p.value is None:
        return [p.name, "—", "", "", "", p.unit]
    places = decimals(p.std or 0.0, p.value)
    number = lambda x: f"{x:z.{places}f}"  # noqa: E731
    if p.upper95 is not None:
        return [p.name, f"< {number(p.upper95)}", number(p.std), "", "upper limit", p.unit]
    freedom = "" if p.freedom is None else f"{p.freedom:.0f}"
    span = f"{number(p.low95)} … {number(p.high95)}"
    unlike = " (as given)" if p.name == "ratio" else doubt(p.value, p.low95, p.high95, p.reason)
    mark = "" if p.significant else unlike
    return [p.name, number(p.value) + mark, number(p.std), freedom, span, p.unit]


_LARGEST_TE_DEG = 0.5
"""Largest transmission error assumed in a start angle of a log, ° of the driven shaft (chosen)."""


def _place(start: LogStart, pair: GearPair | Drive) -> float | None:
    """Return the driving angle of the zero of a log in the hunting period, rad, or None."""
    if start.driving_deg is None or start.driven_deg is None:
        return None
    spreads = start.driving_std_deg or 0.0, start.driven_std_deg or 0.0
    if not any(spreads):  # not fitted: the zero of the first log
        return start.driving_deg * DEG
    ratio = float(pair.ratio)
    uncertain = 3 * math.hypot(ratio * spreads[0], spreads[1]) + _LARGEST_TE_DEG
    if not all(spreads) or not uncertain < 180.0 / pair.hunting_turns:
        return None
    places = start.driving_deg * DEG + np.arange(pair.hunting_turns) * REV
    distance = np.mod(ratio * places - start.driven_deg * DEG + REV / 2, REV) - REV / 2
    return float(places[np.argmin(np.abs(distance))])


def _error(
    model: FlankModel, flank: Flank, orders: Sequence[Order], driving: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return TE of `flank`, rad, with its fractional orders, at driving angles in rad."""
    error = errors_at(model, flank, driving)
    shafts = {"driving": driving, "driven": float(model.ratio) * driving + error}
    for one in orders:
        if is_fractional(one):
            phase = one.order * shafts[one.shaft] + one.phase_deg * DEG
            error = error + one.amplitude_arcsec * ARCSEC * np.sin(phase)
    return error
