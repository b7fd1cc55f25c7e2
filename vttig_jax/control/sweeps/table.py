"""What a sweep gives: one row a case, and a summary in words."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.files.text_tables import key_values, text_table
from ..scenario.spec import ScenarioSpec, spec_table
from ..simulation.metrics import NEAR_MM
from .blocks import REFUSED, Rows


@dataclass(frozen=True)
class SweepTable:
    """A sweep that has run.

    **Arguments**
    - `spec`: of the sweep. - `pair`: name of the gears.
    - `columns`: `case`, the axes, the metrics of the contract and `outcome`, shape (cases,) each;
      NaN for what did not happen.
    - `lane_steps`: steps of the plant of all cases. - `run_s`, `compile_s`: time taken, s.
    - `devices`: how many ran it. - `refusals`: why cases were refused, the first of each kind.
    - `path`: the Parquet file, where one was written.
    """

    spec: ScenarioSpec
    pair: str
    columns: Rows
    axes: tuple[str, ...]
    lane_steps: int
    run_s: float
    compile_s: float
    devices: int
    refusals: tuple[tuple[int, str], ...] = ()
    path: Path | None = None

    @property
    def outcomes(self) -> dict[str, int]:
        """Number of cases by outcome, most frequent first."""
        return dict(Counter(self.columns["outcome"].tolist()).most_common())

    def groups(self) -> list[tuple[str, np.ndarray]]:
        """Cases by the texts among the axes, such as the controller: name, and a mask."""
        texts = [axis for axis in self.axes if self.columns[axis].dtype.kind == "U"]
        if not texts:
            return [("all", np.ones(len(self.columns["case"]), bool))]
        keys = list(zip(*(self.columns[axis].tolist() for axis in texts), strict=True))
        names = [", ".join(key) for key in keys]
        return [(name, np.array([one == name for one in names])) for name in dict.fromkeys(names)]

    def to_json(self) -> dict[str, Any]:
        """The object of schema `vttig.sweep/1`."""
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
            "groups": [self._group(name, mask) for name, mask in self.groups()],
            "refused": [{"case": case, "why": why} for case, why in self.refusals],
            "table": None if self.path is None else self.path.name,
            "scenario": spec_table(self.spec),
        }

    def _group(self, name: str, mask: np.ndarray) -> dict[str, Any]:
        gap = _there(self.columns["residual_gap_deg"][mask])
        interference = _there(self.columns["interference_mm"][mask])
        lost = _there(self.columns["lost_motion_deg"][mask])
        return {
            "name": name,
            "cases": int(mask.sum()),
            "outcomes": dict(Counter(self.columns["outcome"][mask].tolist()).most_common()),
            "residual_gap_deg": _spread(gap),
            "interference_mm": _spread(interference),
            "interfering_share": _share(interference > NEAR_MM),
            "lost_motion_deg": _spread(lost),
        }

    def __str__(self) -> str:
        return _text(self)


def _there(values: np.ndarray) -> np.ndarray:
    return values[~np.isnan(values)]


def _share(which: np.ndarray) -> float | None:
    return float(which.mean()) if len(which) else None


def _spread(values: np.ndarray) -> dict[str, float] | None:
    """Mean, 95 % of all cases, and the extremes."""
    if not len(values):
        return None
    low, high = np.quantile(values, [0.025, 0.975])
    return {
        "mean": float(values.mean()),
        "low95": float(low),
        "high95": float(high),
        "max": float(values.max()),
    }


def _text(table: SweepTable) -> str:
    record = table.to_json()
    outcomes = ", ".join(f"{count} {name}" for name, count in table.outcomes.items())
    each = max(table.lane_steps, 1)
    head = [
        ("cases", f"{record['cases']}: {_sizes(table)}"),
        ("outcomes", outcomes),
        (
            "run",
            f"{table.lane_steps:.3g} lane-steps in {table.run_s:.3g} s"
            f" ({1e9 * table.run_s / each:.3g} ns each), compiled in {table.compile_s:.2g} s,"
            f" {table.devices} device{'s' if table.devices > 1 else ''}",
        ),
    ]
    if table.path is not None:
        head.append(("table", str(table.path)))
    rows = [
        (
            group["name"],
            group["cases"],
            *_cells(group["residual_gap_deg"], ".5f"),
            "–"
            if group["interfering_share"] is None
            else f"{100 * group['interfering_share']:.1f} %",
            *_cells(group["interference_mm"], ".4f")[2:],
            *_cells(group["lost_motion_deg"], ".5f")[:1],
        )
        for group in record["groups"]
    ]
    headers = [
        "",
        "cases",
        ("gap left: mean", "deg"),
        "95 %",
        "max",
        "interfere",
        ("by at most", "mm"),
        ("motion lost: mean", "deg"),
    ]
    lines = [key_values(head, title=table.pair), "", text_table(rows, headers)]
    if table.refusals:
        lines += ["", "notes:"]
        count = table.outcomes.get(REFUSED, 0)
        lines += [f"  {count} cases were refused, such as:"]
        lines += [f"  case {case}: {why}" for case, why in table.refusals]
    return "\n".join(lines)


def _sizes(table: SweepTable) -> str:
    """How many values each axis takes."""
    sizes = {axis: len(np.unique(table.columns[axis])) for axis in table.axes}
    return ", ".join(f"{size} {axis}" for axis, size in sizes.items())


def _cells(spread: dict[str, float] | None, form: str) -> tuple[str, str, str]:
    if spread is None:
        return "–", "–", "–"
    digits = int(form[1:-1])
    shown = {
        name: format(round(value, digits) + 0.0, form) for name, value in spread.items()
    }  # no −0
    return shown["mean"], f"{shown['low95']} … {shown['high95']}", shown["max"]
