"""Table 3 of the paper read in degrees of the driving gear with the opposite sign.

    python fits/paper/driving_degrees.py           prints the tables
    python fits/paper/driving_degrees.py --write   renews the tables of README.md

In this reading the TE of Table 3 is φ₁ − φ₂ z₂/z₁, which is −16/9 of (23). Nothing is fitted.
"""

import argparse
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from compare import (
    HERE,
    PAIR,
    PRINTED,
    RIG,
    markdown,
    range_bound,
    renew,
    run_statistics,
    variable_backlash,
    way,
)

import vttig_jax
from vttig_jax import Eccentricities
from vttig_jax.base.files.text_tables import text_table
from vttig_jax.base.units import DEG
from vttig_jax.kinematics.backlash_map import chunked

BEGIN, END = "<!-- driving degrees: begin -->\n", "<!-- driving degrees: end -->\n"

RATIO = float(PAIR.ratio)
COLUMNS: tuple[str, ...] = ("mean", "max", "min")
HALF_A_DIGIT_DEG = 5e-5
"""Of Table 3. Its rows have four decimals."""

_HALF_A_DIGIT = {
    "driving_mm": 5e-5,
    "driving_phase_deg": 0.05,
    "driven_mm": 5e-5,
    "driven_phase_deg": 0.05,
}
"""Of Table 2."""


def read(values: dict[str, float]) -> dict[str, float]:
    """Statistics of (23) in degrees of the driven gear as statistics of −16/9 of it.

    `place` is (mean − min)/range. No unit and no zero of the TE changes it.
    """
    found = {
        "mean": -values["mean"] / RATIO,
        "max": -values["min"] / RATIO,
        "min": -values["max"] / RATIO,
        "range": values["range"] / RATIO,
    }
    return found | {"place": place(found)}


def place(values: dict[str, float]) -> float:
    """Where the mean lies between the smallest (0) and the largest value (1)."""
    return (values["mean"] - values["min"]) / values["range"]


@dataclass(frozen=True)
class Row:
    """One row of Table 3: its run, its names, and its statistics in degrees as printed."""

    speed_rpm: int
    reversal_deg: int
    source: str
    control: str
    values: dict[str, float]

    def __str__(self) -> str:
        return f"{self.speed_rpm} rpm, {self.source}, {self.control.replace('_', ' ')}"


def rows() -> list[Row]:
    """All sixteen rows of Table 3."""
    found = []
    for run in PRINTED["table_3"]:
        for control in ("with_control", "without_control"):
            for source, numbers in run[control].items():
                values = dict(zip(COLUMNS, numbers, strict=True))
                values["range"] = values["max"] - values["min"]
                values["place"] = place(values)
                turn = run["reversal_deg"][source]
                found.append(Row(run["speed_rpm"], turn, source, control, values))
    return found


@cache
def flank_a(reversal_deg: float) -> dict[str, float]:
    """Statistics of the way to a reversal in this reading, zero at the start."""
    return read(run_statistics(reversal_deg)["A"])


@cache
def rounding(reversal_deg: float) -> dict[str, float]:
    """The most by which half a last digit of every number of Table 2 changes `flank_a`, degrees.

    The changes of the four numbers are added.
    """
    own, total = flank_a(reversal_deg), dict.fromkeys(COLUMNS, 0.0)
    for number, half in _HALF_A_DIGIT.items():
        rig = replace(RIG, **{number: float(getattr(RIG, number)) + half})
        other = read(run_statistics(reversal_deg, rig)["A"])
        total = {name: total[name] + abs(other[name] - own[name]) for name in COLUMNS}
    return total


def explained(row: Row) -> list[str]:
    """Columns of a row that the reading gives on flank A within the rounding of both tables."""
    own, margin = flank_a(row.reversal_deg), rounding(row.reversal_deg)
    return [
        name
        for name in COLUMNS
        if abs(row.values[name] - own[name]) <= margin[name] + HALF_A_DIGIT_DEG
    ]


@dataclass(frozen=True)
class Gap:
    """What a jump of Table 3, as degrees of the driving gear, makes of the backlash, in degrees.

    - `driven`: the jump in degrees of the driven gear. - `constant`: that less j_v at the reversal.
    - `smallest`: over the hunting period. - `closed`: share of the hunting period without backlash.
    """

    driven: float
    constant: float
    smallest: float
    closed: float


def gap(reversal_deg: float, printed: float) -> Gap:
    """A jump read in degrees of the driving gear, with the eccentricities of Table 2."""
    angle, rig = way(360.0 * PAIR.hunting_turns), replace(RIG, constant_backlash_deg=0.0)
    variable = chunked(lambda piece: vttig_jax.exact_backlash(piece, PAIR, rig), angle) / DEG
    driven = printed * RATIO
    constant = driven - variable_backlash(reversal_deg)["exact"]
    whole = constant + variable
    return Gap(driven, constant, float(whole.min()), float(np.mean(whole < 0)))


def driving_rig() -> Eccentricities:
    """Table 2 with the constant backlash that "simulation, 60 rpm" has in this reading."""
    run = next(r for r in PRINTED["table_3"] if r["speed_rpm"] == 60)
    found = gap(run["reversal_deg"]["simulation"], run["backlash_deg"]["simulation"])
    return replace(RIG, constant_backlash_deg=found.constant)


def tables() -> str:
    """All tables as Markdown, as the script prints them and the README shows them."""
    return markdown(
        ("Table 2 as −16/9 of (23), in degrees of the driving gear", _reading_table()),
        ("Table 3 less flank A in this reading, in degrees", _row_table()),
        ("The backlash column read in degrees of the driving gear", _gap_table()),
    )


def _reading_table() -> str:
    shown, other = [], driving_rig()
    turns = dict.fromkeys(row.reversal_deg for row in rows())
    for turn in turns:
        shown.append((f"to {turn}°, flank A", *_five(flank_a(turn))))
        for rig in (RIG, other):
            name = f"to {turn}°, flank A and B, j_c {float(rig.constant_backlash_deg):.4f}°"
            shown.append((name, *_five(read(run_statistics(turn, rig)["A and B"]))))
    margin = {name: max(rounding(turn)[name] for turn in turns) for name in COLUMNS}
    shown.append(
        ("flank A, rounding of Table 2", *(f"±{margin[name]:.5f}" for name in COLUMNS), "", "")
    )
    bound = f"{range_bound() / RATIO:.4f}"
    shown.append(("largest range on one flank, 2(e₁ + e₂)/r_b1", *[""] * 3, bound, ""))
    return text_table(shown, ["", "mean", "max", "min", "range", "place of mean"])


def _row_table() -> str:
    shown = []
    for row in rows():
        own = flank_a(row.reversal_deg)
        less = [_signed(row.values[name] - own[name]) for name in (*COLUMNS, "range")]
        places = (f"{values['place']:.2f}" for values in (row.values, own))
        shown.append((str(row), *less, *places, ", ".join(explained(row)) or None))
    headers = ["", *COLUMNS, "range", "place, printed", "read", "explained"]
    return text_table(shown, headers)


def _gap_table() -> str:
    shown = []
    for run in PRINTED["table_3"]:
        for source, turn in run["reversal_deg"].items():
            printed = run["backlash_deg"][source]
            found = gap(turn, printed)
            shown.append(
                (
                    f"{run['speed_rpm']} rpm to {turn}°, {source}",
                    f"{printed:.4f}",
                    *(f"{value:.4f}" for value in (found.driven, found.constant)),
                    _signed(found.smallest),
                    f"{found.closed:.0%}",
                )
            )
    headers = [
        "",
        ("printed", "°"),
        ("of the driven gear", "°"),
        ("less j_v", "°"),
        ("smallest", "°"),
        "without backlash",
    ]
    return text_table(shown, headers)


def _five(values: dict[str, float]) -> list[str]:
    signed = [_signed(values[name]) for name in COLUMNS]
    return [*signed, f"{values['range']:.4f}", f"{values['place']:.2f}"]


def _signed(value: float) -> str:
    """A number with sign and four decimals, and no −0."""
    return f"{round(value, 4) + 0.0:+.4f}"


def main(argv: list[str] | None = None) -> None:
    """Print the tables; with `--write` renew README.md as well."""
    parser = argparse.ArgumentParser(description="Table 3 read in degrees of the driving gear.")
    parser.add_argument("--write", action="store_true", help="renew README.md")
    text = tables()
    if parser.parse_args(argv).write:
        renew(HERE, (BEGIN, END), text, {})
    print(text)


if __name__ == "__main__":
    main()
