"""Result of a plan: its classes, report and JSON object, and the notes on it."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...base.files.text_tables import key_values, listed, text_table
from ...base.results import TextResult
from ...base.units import ARCSEC, DEG, duration_text
from ...identify.result import conditions
from ...model.columns import DELAY, GAP
from ...model.density import LAGS
from ...model.mixed_fit import MixedFit
from ...model.parameter import Parameter, open_reasons
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from .noise import PlannedNoise, frozen_counts
from .run import PlannedRun

_KEYS = ("unit", "std", "assumed", "determined", "significant", "reason", "wanted")


@dataclass(frozen=True)
class PlannedParameter(Parameter):
    """Parameter without a value, whose `std` is the expected one; None if the fit will give none.

    **Arguments**
    - `assumed`: assumed amplitude, phase or delay; None if no value is assumed.
    - `wanted`: requested standard error in `unit`; None without a request.
    """

    assumed: float | None = None
    wanted: float | None = None

    def to_json(self) -> dict:
        """Return the JSON object of the parameter, as it stands under `parameters` of a plan."""
        return {name: getattr(self, name) for name in _KEYS}


@dataclass(frozen=True)
class Plan(TextResult):
    """Expected result of the fit of a run that is not yet recorded.

    **Arguments**
    - `parameters`: parameter name of a fit → `PlannedParameter`.
    - `run`: motion; `used`: number of its samples at steady speed, which the fit uses.
    - `noise`, `counting_std_deg`, `row_std_deg`: assumed noise of the samples, standard deviation
      of the counting error, and of the noise of a row, which lasts `row_s`.
    - `flanks`, `conditional_on`, `outcome`: as in the result of a fit.
    - `short`: shafts that turn too little.
    - `notes`: sentences for the reader.
    """

    pair: GearPair | Drive
    parameters: dict[str, PlannedParameter]
    run: PlannedRun
    used: int
    noise: PlannedNoise
    counting_std_deg: float
    row_s: float
    row_std_deg: float
    flanks: tuple[str, ...]
    conditional_on: tuple[str, ...]
    outcome: str
    short: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """Duration of the whole recording, s, dwells included."""
        return self.run.duration_s

    @property
    def samples(self) -> int:
        """Number of samples of the whole recording."""
        return self.run.samples

    def std(self, name: str) -> float:
        """Return the expected standard error of a parameter in its unit; infinite if None."""
        std = self.parameters[name].std
        return math.inf if std is None else std

    def to_json(self) -> dict:
        """Return the object of schema `vttig.plan/1`."""
        run = self.run
        return {
            "schema": "vttig.plan/1",
            "pair": self.pair.name,
            "outcome": self.outcome,
            "run": asdict(run) | {"speeds_rpm": list(run.speeds_rpm), "passes": run.pass_count},
            "duration_s": self.duration_s,
            "samples": {"total": self.samples, "used": self.used},
            "flanks": list(self.flanks),
            "conditional_on": list(self.conditional_on),
            "noise": asdict(self.noise)
            | {
                "counting_std_deg": self.counting_std_deg,
                "block_s": self.row_s,
                "block_std_deg": self.row_std_deg,
                "model": f"AR({LAGS})",
            },
            "parameters": {name: p.to_json() for name, p in self.parameters.items()},
            "weakest_direction": None,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        samples = f"{self.samples} at {self.run.rate_hz:g} Hz, {self.used} to be fitted"
        asked = [("run", self.run), ("time", _time(self.duration_s)), ("samples", samples)]
        asked += [("flanks", " and ".join(self.flanks)), ("noise assumed", _noise(self))]
        asked.append(("outcome of a fit", self.outcome.replace("_", " ")))
        head = key_values(asked, title=f"plan for {self.pair.name or 'a drive or pair'}")
        shown = [p for p in self.parameters.values() if p.determined]
        any_wanted = any(p.wanted is not None for p in shown)
        titles = ["parameter", "expected std", *(["wanted"] if any_wanted else []), "at", "unit"]
        rows = []
        for p in shown:
            expected = "–" if p.std is None else f"{p.std:.2g}"
            expected += "" if p.significant else " (not significant)"
            wanted = ["" if p.wanted is None else f"{p.wanted:g}"] if any_wanted else []
            at = "" if p.assumed is None else f"{p.assumed:g}"
            rows.append([p.name, expected, *wanted, at, p.unit])
        parts = [head, text_table(rows, titles, align="l" + "r" * (len(titles) - 2) + "l")]
        parts += conditions(self.conditional_on)
        parts += listed("undetermined", open_reasons(self.parameters.values()))
        return "\n\n".join([*parts, *listed("notes", self.notes)])


def planned_parameter(parameter: Parameter, assumed: float | None) -> PlannedParameter:
    """Return the expected accuracy of a parameter of the planned fit, with its assumed value."""
    told, known = parameter.determined, assumed is not None
    significant = told and (parameter.significant or not known)
    shown: dict[str, Any] = {"std": parameter.std, "determined": told, "significant": significant}
    shown["reason"] = parameter.reason if known or not told else None
    return PlannedParameter(parameter.name, parameter.unit, **shown, assumed=assumed)


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    longer = f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
    return f"{seconds:.0f} s ({longer})"


def _noise(plan: Plan) -> str:
    noise = plan.noise
    memory = (
        f", correlated over {duration_text(noise.correlation_s)}" if noise.correlation_s else ""
    )
    parts = [f"{noise.std_deg:g}°{memory}"] if noise.std_deg else []
    parts += [f"{noise.white_std_deg:g}° white"] if noise.white_std_deg else []
    counting = plan.counting_std_deg
    if counting:
        parts.append(f"{counting:.2g}° ({counting * DEG / ARCSEC:.2g}″) of counting")
    return " + ".join(parts)


def notes(
    pair: GearPair | Drive,
    run: PlannedRun,
    options: HarmonicOrders,
    noise: PlannedNoise,
    fit: MixedFit,
    passes: int,
) -> tuple[str, ...]:
    """Return notes on effects that increase the standard errors, and on what is not fitted.

    `fit` is the expected fit, and `passes` the number of steady passes in it.
    """
    sentences = [*frozen_counts(pair, run.speeds_rpm, run.rate_hz), *_aliased(pair, run, options)]
    planned = run.pass_count * len(run.speeds_rpm)
    if passes < planned:
        sentences.append(
            f"{planned - passes} of {planned} passes have no steady part that a fit would use: a"
            " speed below 1 % of the fastest counts as standstill"
        )
    if noise.std_deg > 0 and noise.correlation_s == 0:
        sentences.append(
            "noise is taken as white; on real rigs it is correlated and standard errors are several"
            " times larger: give its correlation time, which `vttig fit` prints for a log of a rig"
        )
    return (*sentences, *_delay_notes(fit, one_speed=len(run.speeds_rpm) == 1))


def _delay_notes(fit: MixedFit, *, one_speed: bool) -> list[str]:
    """Return what a fitted delay costs the constant backlash g, and what tells it.

    If the delay d were known, g would have the smaller variance var(g) − cov(g, d)²/var(d).
    """
    posterior, index = fit.posterior, fit.posterior.problem.index
    if not {GAP, DELAY} <= set(index):
        return []
    rows = np.stack([posterior.row(GAP), posterior.row(DELAY)])
    (gap, both), (_, own) = posterior.told(rows, moved=True)[1]
    known = math.sqrt(max(gap - both**2 / own, 0.0))
    if known > 0.9 * math.sqrt(gap):
        return []
    width = posterior.problem.columns[index[DELAY]].width
    sentences = [
        "a delay between the channels is fitted beside the constant backlash; if both channels are"
        " sampled at the same instant, plan and fit with --delay off, and the standard error of the"
        f" constant backlash is {known / DEG:.2g}°"
    ]
    if math.sqrt(own) > 0.5 * width:
        sentences.append(
            f"only the assumption of ± {1e3 * width:.2g} ms tells the delay from the constant"
            " backlash; plan a second speed"
        )
    elif one_speed:
        sentences.append(
            "only the ramps tell the delay from the constant backlash, and all of them are counted:"
            " the driven side must stay on its flank while the drive slows down; a second speed"
            " tells them apart without the ramps"
        )
    return sentences


def _aliased(pair: GearPair | Drive, run: PlannedRun, options: HarmonicOrders) -> list[str]:
    """Return sentences on orders above half the sampling rate at the fastest speed."""
    turns_a_second = max(run.speeds_rpm) / 60
    teeth = 0 if isinstance(pair, Drive) else pair.driving.teeth
    mesh = tuple(k for k in range(1, options.mesh_orders + 1) if teeth)
    shafts = {
        "driving": (1.0, options.driving_orders),
        "driven": (float(pair.ratio), options.driven_orders),
        "mesh": (float(teeth), mesh),
    }
    sentences = []
    for name, (relative, orders) in shafts.items():
        aliased = [k for k in orders if k * relative * turns_a_second >= run.rate_hz / 2]
        if aliased:
            sentences.append(
                f"{name} orders {', '.join(map(str, aliased))} lie above half the sampling rate at"
                f" {max(run.speeds_rpm):g} rpm and alias; sample faster or take them out of [fit]"
            )
    return sentences
