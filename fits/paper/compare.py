"""What follows from Table 2 of the paper, beside what the paper prints in Tables 1 and 3.

    python fits/paper/compare.py           prints the tables
    python fits/paper/compare.py --write   renews the tables of README.md and the pictures

The paper's numbers are quoted in `vttig_jax/runs/paper_printed.toml`; every other number is
computed here. Angles are degrees of the driven gear.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import vttig_jax
from vttig_jax import Eccentricities
from vttig_jax.base.files.run_folder import RunFolder
from vttig_jax.base.files.text_tables import text_table
from vttig_jax.kinematics.backlash_map import BacklashMap, chunked
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.te_curve import TECurve
from vttig_jax.plotting.backlash_map import plot_map
from vttig_jax.plotting.fit import plot_te
from vttig_jax.plotting.save import png
from vttig_jax.rig.paper import paper_eccentricities, paper_pair
from vttig_jax.runs.paper_runs import printed_tables

vttig_jax.enable_x64()

HERE = Path(__file__).resolve().parent
BEGIN, END = "<!-- tables: begin -->\n", "<!-- tables: end -->\n"

PRINTED = printed_tables()
PAIR, RIG = paper_pair(), paper_eccentricities()
"""Tables 1 and 2; the constant backlash is the simulated jump at 7560° less j_v there."""

_CLOSED = vttig_jax.transmission_error, vttig_jax.backlash
RELATIONS: dict[str, tuple[Callable[..., Any], Callable[..., Any], dict[str, Any]]] = {
    "closed, α": (*_CLOSED, {"pressure_angle": "reference"}),
    "closed, α_w": (*_CLOSED, {"pressure_angle": "working"}),
    "exact": (vttig_jax.exact_transmission_error, vttig_jax.exact_backlash, {}),
}
"""(19)–(21) as printed, (19)–(21) with the working pressure angle, and the exact relation."""

_STEP_DEG = 0.5
_SPANNED_DEG = (1080.0, 3600.0)


def way(reversal_deg: float) -> np.ndarray:
    """Driving angles from 0 to a reversal every 0.5°, rad; the end is left out."""
    return np.radians(np.arange(round(reversal_deg / _STEP_DEG)) * _STEP_DEG)


def statistics(error: np.ndarray) -> dict[str, float]:
    """Mean, largest, smallest and range of angles in rad, in degrees."""
    e = np.degrees(error)
    return {"mean": e.mean(), "max": e.max(), "min": e.min(), "range": np.ptp(e)}


def te(
    name: str,
    angle: np.ndarray,
    flank: str,
    reference: str = "start",
    rig: Eccentricities = RIG,
) -> np.ndarray:
    """TE of one flank by one of the relations, rad; chunked, so that all ways compile once."""
    error, _, options = RELATIONS[name]
    return chunked(
        lambda piece: error(piece, PAIR, rig, flank, reference=reference, **options), angle
    )


def flank_statistics() -> dict[tuple[str, str], dict[str, float]]:
    """(flank, relation) → statistics over one hunting period, each flank zero at φ₁ = 0."""
    angle = way(360.0 * PAIR.hunting_turns)
    return {
        (flank, name): statistics(te(name, angle, flank))
        for flank in ("A", "B")
        for name in RELATIONS
    }


def range_bound() -> float:
    """Largest range Table 2 allows on one flank whatever the phases: 2 K (e₁ + e₂)."""
    radius = float(PAIR.base_radii[1, 0])
    return float(np.degrees(2 * (RIG.driving_mm + RIG.driven_mm) / radius))


def run_statistics(reversal_deg: float, rig: Eccentricities = RIG) -> dict[str, dict[str, float]]:
    """Exact statistics of one run, zero at the start on flank A.

    "A" is the way to the reversal; "A and B" is there and back, constant backlash included.
    """
    angle = way(reversal_deg)
    forward, backward = (te("exact", angle, flank, "absolute", rig) for flank in ("A", "B"))
    start = forward[0]
    both = np.concatenate([forward - start, backward - start])
    return {"A": statistics(forward - start), "A and B": statistics(both)}


def variable_backlash(reversal_deg: float) -> dict[str, float]:
    """Relation → j_v at a driving angle: the backlash of a rig without constant backlash."""
    angle, rig = np.radians(reversal_deg), replace(RIG, constant_backlash_deg=0.0)
    return {
        name: float(np.degrees(backlash(angle, PAIR, rig, **options)))
        for name, (_, backlash, options) in RELATIONS.items()
    }


def explained_span(name: str) -> float:
    """Most that j can differ between 1080° and 3600°, over all phases of the driven gear.

    Both angles are whole turns of the driving gear, so e₁ stands at the same place and has no part
    in it.
    """
    _, backlash, options = RELATIONS[name]
    angles = np.radians(_SPANNED_DEG)

    def span(phase_deg: jax.Array) -> jax.Array:
        rig = Eccentricities(RIG.driving_mm, RIG.driving_phase_deg, RIG.driven_mm, phase_deg)
        first, last = backlash(angles, PAIR, rig, **options)
        return last - first

    return float(np.degrees(np.abs(jax.vmap(span)(jnp.arange(0.0, 360.0, 0.5))).max()))


def printed_span(source: str) -> float:
    """Difference of the backlash column of Table 3 between 1080° and 3600°."""
    jumps = {r["reversal_deg"][source]: r["backlash_deg"][source] for r in PRINTED["table_3"]}
    first, last = (jumps[int(angle)] for angle in _SPANNED_DEG)
    return last - first


def dimensions() -> list[tuple[str, float, float]]:
    """Table 1: name, computed, printed. Standard addendum m, dedendum 1.25 m, thickness πm/2."""
    printed, module = PRINTED["table_1"], float(PAIR.module_mm)
    rows = []
    for position, gear in enumerate(("driving", "driven")):
        pitch = 2 * float(PAIR.reference_radii[position])
        rows.append((f"tip diameter, {gear}", pitch + 2 * module, printed["tip_diameters_mm"]))
        rows.append((f"root diameter, {gear}", pitch - 2.5 * module, printed["root_diameters_mm"]))
    rows = [(name, value, both["driven" in name]) for name, value, both in rows]
    taper = float(PAIR.thinning) * float(PAIR.driven.face_width_mm) / 2
    middle = np.pi * module / 2
    rows.append(("tooth thickness, thin end", middle - taper, printed["thin_end_mm"]))
    rows.append(("tooth thickness, thick end", middle + taper, printed["thick_end_mm"]))
    rows.append(("transmission ratio 1/i", float(1 / PAIR.ratio), printed["transmission_ratio"]))
    return rows


def tables() -> str:
    """All tables as Markdown, as the script prints them and the README shows them."""
    return markdown(
        ("Table 1: dimensions in mm", _dimension_table()),
        ("TE of each flank over one hunting period, zero at the start, in degrees", _flank_table()),
        ("TE of whole runs, in degrees", _run_table()),
        ("Backlash at the reversals, in degrees", _backlash_table()),
        ("How far the backlash differs between 1080° and 3600°, in degrees", _span_table()),
    )


def markdown(*parts: tuple[str, str]) -> str:
    """Titles and text tables, one below the other."""
    return "\n".join(f"**{title}**\n\n```text\n{table}\n```\n" for title, table in parts)


def _dimension_table() -> str:
    rows = [
        (name, f"{value:.4f}", f"{printed:g}", f"{printed - value:+.4f}")
        for name, value, printed in dimensions()
    ]
    return text_table(rows, ["", "computed", "printed", "difference"])


def _flank_table() -> str:
    rows = [
        (f"flank {flank}, {name}", *_four(values))
        for (flank, name), values in flank_statistics().items()
    ]
    rows.append(("largest range on one flank, 2K(e₁ + e₂)", "", "", "", f"{range_bound():.4f}"))
    return text_table(rows, ["", "mean", "max", "min", "range"])


def _run_table() -> str:
    rows = []
    for run in PRINTED["table_3"]:
        reversal = run["reversal_deg"]["experiment"]
        head = f"{run['speed_rpm']} rpm to {reversal}°"
        rows += [
            (f"{head}, Table 2, flank {name}", *_four(values))
            for name, values in run_statistics(reversal).items()
        ]
        for control in ("with_control", "without_control"):
            for source, (mean, high, low) in run[control].items():
                values = {"mean": mean, "max": high, "min": low, "range": high - low}
                rows.append((f"  printed: {source}, {control.replace('_', ' ')}", *_four(values)))
    return text_table(rows, ["", "mean", "max", "min", "range"])


def _backlash_table() -> str:
    rows = []
    for run in PRINTED["table_3"]:
        for source, angle in run["reversal_deg"].items():
            variable = variable_backlash(angle)
            jump = run["backlash_deg"][source]
            rows.append(
                (
                    f"{source}, {run['speed_rpm']} rpm",
                    f"{angle}°",
                    *(f"{value:.5f}" for value in variable.values()),
                    f"{jump:.4f}",
                    f"{jump - variable['exact']:.4f}",
                )
            )
    names = [f"j_v {name}" for name in RELATIONS]
    return text_table(rows, ["", "reversal", *names, "j printed", "j printed − j_v"])


def _span_table() -> str:
    first, last = (variable_backlash(angle)["exact"] for angle in _SPANNED_DEG)
    rows = [
        (f"at most, any phase of e₂, {name}", f"{explained_span(name):.5f}") for name in RELATIONS
    ]
    rows.append(("with the phases of Table 2, exact", f"{abs(last - first):.5f}"))
    rows += [
        (f"printed: {source}", f"{printed_span(source):.4f}")
        for source in ("experiment", "simulation")
    ]
    return text_table(rows, ["", "span"])


def _four(values: dict[str, float]) -> list[str]:
    return [f"{values[name]:+.4f}" for name in ("mean", "max", "min")] + [f"{values['range']:.4f}"]


def pictures() -> dict[str, bytes]:
    """PNG by file name: TE of both flanks over the hunting period, and the backlash map."""
    return {"transmission_error.png": png(_te_picture()), "backlash_map.png": png(_map_picture())}


def _te_picture() -> Figure:
    angle = way(360.0 * PAIR.hunting_turns)
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    ax = figure.add_subplot()
    for flank in ("A", "B"):
        plot_te(TECurve(flank, angle, te("exact", angle, flank), angle), ax=ax, unit="deg")
    measured = next(r for r in PRINTED["table_3"] if r["speed_rpm"] == 60)
    _, high, low = measured["without_control"]["experiment"]
    ax.axhspan(low, high, color="0.9", zorder=0, label="Table 3, 60 rpm, experiment: min to max")
    ax.set_title("exact TE of Table 2, each flank zero at the start", loc="left", fontsize="medium")
    ax.legend(loc="lower right", ncols=3, fontsize="small", frameon=False)
    ax.set_xlim(0.0, 360.0 * PAIR.hunting_turns)
    ax.set_ylim(-0.1, 0.14)
    return figure


def _map_picture() -> Figure:
    figure = plot_map(BacklashMap(exact_model(PAIR, RIG), closed_model(PAIR, RIG), PAIR))
    runs, period = PRINTED["table_3"], 360 * PAIR.hunting_turns
    marks = [
        figure.axes[0].scatter(
            [run["reversal_deg"][source] % period for run in runs],
            [run["backlash_deg"][source] for run in runs],
            marker=marker,
            color="0.1",
            zorder=3,
            label=f"Table 3, {source}",
        )
        for source, marker in (("experiment", "x"), ("simulation", "+"))
    ]
    figure.legend(handles=marks, loc="outside lower right", ncols=2, fontsize="small")
    return figure


def renew(folder: Path, marks: tuple[str, str], text: str, drawn: dict[str, bytes]) -> None:
    """Put `text` between the two marks of the folder's README.md, and pictures beside it."""
    begin, end = marks
    before, rest = (folder / "README.md").read_text(encoding="utf-8").split(begin)
    after = rest.split(end)[1]
    with RunFolder(folder, overwrite=True) as run:
        run.write_text("README.md", f"{before}{begin}\n{text}\n{end}{after}")
        for name, data in drawn.items():
            run.write_bytes(name, data)


def main(argv: list[str] | None = None) -> None:
    """Print the tables; with `--write` renew README.md and the pictures as well."""
    parser = argparse.ArgumentParser(description="Table 2 of the paper beside its Tables 1 and 3.")
    parser.add_argument("--write", action="store_true", help="renew README.md and the pictures")
    text = tables()
    if parser.parse_args(argv).write:
        renew(HERE, (BEGIN, END), text, pictures())
    print(text)


if __name__ == "__main__":
    main()
