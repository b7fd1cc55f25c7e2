"""Result of a sweep: a table with one row per case, and its report."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.files.text_tables import key_values, text_table
from ...base.results import PlottedResult
from ...base.units import DEG
from ..scenario.spec import ScenarioSpec, spec_table
from ..simulation.case import NEAR_DEG, NEAR_MM, overdone
from ..simulation.result import flanks_text

Rows = dict[str, np.ndarray]
"""Columns of a table: `case`, the axes, the metrics, `outcome`."""

DRAW = "draw"
"""Name of the axis of maps drawn from a posterior; this axis varies slowest."""

REFUSED = "refused"
"""Outcome of a case whose values contradict each other, so that it is not simulated."""

_MOST_VALUES = 16
"""Most values of a listed axis for which a report has a row each; a chosen value."""

_NUMBERS = (
    *("lost_motion_deg", "output_error_deg", "largest_jump_deg", "wrong_flank_deg"),
    *("over_compensation_deg", "thrown_back_deg"),
)
"""Metrics whose mean, range and maximum a report of a sweep also has."""

_COLUMNS: tuple[tuple[str | tuple[str, str], str, str], ...] = (
    (("gap left", "deg"), "residual_gap_deg", "{mean:z.5f}"),
    ("95 %", "residual_gap_deg", "{low95:z.5f} … {high95:z.5f}"),
    ("max", "residual_gap_deg", "{max:z.5f}"),
    (("most", "mm"), "interference_mm", "{max:z.4f}"),
    (("largest jump", "deg"), "largest_jump_deg", "{max:z.5f}"),
    (("wrong flank", "deg"), "wrong_flank_deg", "{max:z.2f}"),
    (("lost motion", "deg"), "lost_motion_deg", "{mean:z.5f}"),
    (("output error", "deg"), "output_error_deg", "{max:z.5f}"),
)
"""Name of a column of the report, its metric, and its text; z: no −0."""

_REMARKS = {
    "early_share": "of the cases the flanks change before the turn; the driven shaft overruns when"
    " the motor brakes.",
    "over_share": "of the cases the motor makes up for more than the gap; the gap that the"
    " controller believes is too large there.",
    "thrown_share": "of the cases the motor throws the driven shaft off the flank that it meets;"
    " choose a longer judgement.jump_s.",
}
"""Share of the cases of a group → end of its remark."""


def grouped(keys: Sequence[Any]) -> Iterator[tuple[Any, np.ndarray]]:
    """Yield each different key of some rows, in the order of the rows, and the mask of its rows."""
    for key in dict.fromkeys(keys):
        yield key, np.array([one == key for one in keys])


@dataclass(frozen=True)
class SweepTable(PlottedResult):
    """Result of a finished sweep.

    **Arguments**
    - `spec`: specification of the sweep. - `pair`: name of the gears.
    - `columns`: `case`, the axes, the metrics of `simulate` and `outcome`, shape (cases,) each; NaN
      for events that did not happen.
    - `axes`: names of the axes. - `lane_steps`: plant steps of all cases.
    - `run_s`: time of the whole run without `compile_s`, in which programs were compiled, s.
    - `devices`: number of devices, 0 if the sweep was read from its folder.
    - `refusals`: first refused case of each reason, and the reason.
    - `path`: Parquet file or None.
    - `closing`: decrease of the backlash per axial displacement, rad/mm; NaN if it is not known.
    """

    spec: ScenarioSpec
    pair: str
    columns: Rows
    axes: tuple[str, ...]
    lane_steps: int = 0
    run_s: float = math.nan
    compile_s: float = math.nan
    devices: int = 0
    refusals: tuple[tuple[int, str], ...] = ()
    path: Path | None = None
    closing: float = math.nan

    @property
    def outcomes(self) -> dict[str, int]:
        """Number of cases by outcome, most frequent first."""
        return dict(Counter(self.columns["outcome"].tolist()).most_common())

    def groups(self, listed: bool = False) -> list[tuple[str, np.ndarray]]:
        """Return the groups of cases with equal text values on all axes: name, and mask of rows.

        With `listed`, cases of a group also have equal numbers on each axis that the file lists
        value by value, if these are few; the values of a range stay together.
        """
        texts = [axis for axis in self.axes if self.columns[axis].dtype.kind == "U"]
        given = {} if self.spec.sweep is None or not listed else self.spec.sweep.axes
        numbers = [
            axis
            for axis in self.axes
            if axis not in texts
            and isinstance(values := given.get(axis), tuple)
            and len(values) <= _MOST_VALUES
        ]
        if not texts and not numbers:
            return [("all", np.ones(len(self.columns["case"]), bool))]
        shown = [self.columns[axis].tolist() for axis in texts]
        for axis in numbers:
            name = axis.rpartition(".")[2]
            shown.append([f"{name} {value:g}" for value in self.columns[axis]])
        return list(grouped([", ".join(key) for key in zip(*shown, strict=True)]))

    def to_json(self) -> dict[str, Any]:
        """Return the object of schema `vttig.sweep/1`."""
        return {
            "schema": "vttig.sweep/1",
            "pair": self.pair,
            "cases": len(self.columns["case"]),
            "lane_steps": self.lane_steps,
            "run_s": self.run_s,
            "compile_s": self.compile_s,
            "devices": self.devices,
            "axes": list(self.axes),
            "outcomes": self.outcomes,
            "groups": [self._group(name, mask) for name, mask in self.groups(listed=True)],
            "refused": [{"case": case, "why": why} for case, why in self.refusals],
            "table": None if self.path is None else self.path.name,
            "scenario": spec_table(self.spec),
        }

    def _group(self, name: str, mask: np.ndarray) -> dict[str, Any]:
        gap = _without_nan(self.columns["residual_gap_deg"][mask])
        interference = _without_nan(self.columns["interference_mm"][mask])
        numbers = {name: _spread(_without_nan(self.columns[name][mask])) for name in _NUMBERS}
        interferes = interference > NEAR_MM
        draws = None
        if DRAW in self.columns:
            draws = self.columns[DRAW][mask & ~np.isnan(self.columns["interference_mm"])]
        over, thrown = (_share(np.asarray(one)[mask]) for one in overdone(self.columns))
        early = _without_nan(self.columns["early_jump_deg"][mask])
        allowed = 1.01 * max(self.spec.judgement.margin_mm, 0.0) * self.closing / DEG + NEAR_DEG
        return {
            "name": name,
            "cases": int((mask & (self.columns["outcome"] != REFUSED)).sum()),
            "outcomes": dict(Counter(self.columns["outcome"][mask].tolist()).most_common()),
            "residual_gap_deg": _spread(gap),
            "interference_mm": _spread(interference),
            "interfering_share": _share(interferes),
            "interfering_share_95": _share_interval(interferes, draws),
            "early_share": None if math.isnan(self.closing) else _share(early > allowed),
            "over_share": over,
            "thrown_share": thrown,
            **numbers,
        }

    def __str__(self) -> str:
        record = self.to_json()
        outcomes = ", ".join(f"{count} {name}" for name, count in self.outcomes.items())
        steps = max(self.lane_steps, 1)
        sizes = ", ".join(f"{len(np.unique(self.columns[axis]))} {axis}" for axis in self.axes)
        head = [("cases", f"{record['cases']}: {sizes}"), ("outcomes", outcomes)]
        if not {"plant_map", "controller_map"} & set(self.axes):
            plant = "draws of " if DRAW in self.axes else ""
            head.append(("flanks", plant + flanks_text(self.spec)))
        if self.devices:
            run = (
                f"{self.lane_steps:.3g} lane-steps in {self.run_s:.3g} s"
                f" ({1e9 * self.run_s / steps:.3g} ns each), compiled in {self.compile_s:.2g} s,"
                f" {self.devices} device{'s' if self.devices > 1 else ''}"
            )
            head.append(("run", run))
        if self.path is not None:
            head.append(("table", str(self.path)))
        rows = []
        for group in record["groups"]:
            spreads = [(group[metric], form) for _, metric, form in _COLUMNS]
            cells = ["–" if one is None else form.format(**one) for one, form in spreads]
            share = _share_text(group["interfering_share"], group["interfering_share_95"])
            rows.append((group["name"], group["cases"], *cells[:3], share, *cells[3:]))
        names = [name for name, _, _ in _COLUMNS]
        headers = ["", "cases", *names[:3], "interfere", *names[3:]]
        remarks = [
            f"{group['name']}: in {100 * group[share]:.1f} % {what}"
            for share, what in _REMARKS.items()
            for group in record["groups"]
            if group[share]
        ]
        remarks += [
            text
            for group, (_, mask) in zip(record["groups"], self.groups(listed=True), strict=True)
            if (text := _machines(self, group, mask))
        ]
        lines = [*remarks, *[""] * bool(remarks), key_values(head, title=self.pair), ""]
        lines += [text_table(rows, headers)]
        if self.refusals:
            lines += ["", "notes:"]
            count = self.outcomes.get(REFUSED, 0)
            lines += [f"  {count} cases were refused, such as:"]
            lines += [f"  case {case}: {why}" for case, why in self.refusals]
        return "\n".join(lines)


def _without_nan(values: np.ndarray) -> np.ndarray:
    return values[~np.isnan(values)]


def _share(mask: np.ndarray) -> float | None:
    return float(mask.mean()) if len(mask) else None


def _share_interval(mask: np.ndarray, draws: np.ndarray | None) -> list[float] | None:
    """Return the interval that holds the shares of 95 % of the posterior draws; None without.

    Its ends are shares of draws: few draws are all of them in it.
    """
    if draws is None or not len(mask):
        return None
    _, place = np.unique(draws, return_inverse=True)
    shares = np.bincount(place, mask) / np.bincount(place)
    low = np.quantile(shares, 0.025, method="lower")
    return [float(low), float(np.quantile(shares, 0.975, method="higher"))]


def _spread(values: np.ndarray) -> dict[str, float] | None:
    """Return the mean, the 2.5 % and 97.5 % quantiles and the maximum; None without values."""
    if not len(values):
        return None
    low, high = np.quantile(values, [0.025, 0.975])
    return {
        "mean": float(values.mean()),
        "low95": float(low),
        "high95": float(high),
        "max": float(values.max()),
    }


def _machines(table: SweepTable, group: dict[str, Any], mask: np.ndarray) -> str:
    """Say what share of its turns one machine closes too far, where the draws leave it open."""
    low, high = group["interfering_share_95"] or (0.0, 0.0)
    if high - low < 0.1:
        return ""
    mask = mask & ~np.isnan(table.columns["interference_mm"])
    draws, place = np.unique(table.columns[DRAW][mask], return_inverse=True)
    most = np.zeros(len(draws))
    np.maximum.at(most, place, table.columns["interference_mm"][mask])
    count, few = len(draws), len(draws) < 40  # of fewer, 2.5 % is less than one
    freed = most.max() if few else np.quantile(most, 0.975, method="higher")
    share = f"{100 * low:.1f} to {100 * high:.1f} % of its turns"
    among = f"{'all' if few else '95 % of the'} {count} draws"
    return (
        f"{group['name']}: one machine closes too far at {share} ({among}),"
        f" {100 * group['interfering_share']:.1f} % in the mean of the draws; with"
        f" {math.ceil(1e3 * freed) / 1e3:.3f} mm more of judgement.margin_mm,"
        f" {'none' if few else 'at most 2.5 %'} of the draws would."
    )


def _share_text(share: float | None, interval: list[float] | None) -> str:
    if share is None:
        return "–"
    ends = f" ({100 * interval[0]:.1f} … {100 * interval[1]:.1f})" if interval else ""
    return f"{100 * share:.1f} %{ends}"
