"""The reversals of the paper's Figs. 16–20 simulated, beside its Table 3.

    python fits/paper/reversals.py           prints the tables
    python fits/paper/reversals.py --write   renews the tables of README.md and the pictures

Angles are degrees of the driven gear unless they are driving angles.
"""

import argparse
from typing import Any

import numpy as np
from compare import HERE, PRINTED, markdown, renew
from experiments import (
    CONTROLLERS,
    HIGH_DRAG_NM,
    PAIR,
    SCENARIO,
    Experiment,
    backlash,
    degrees_per_mm,
    experiments,
    judged_ahead,
    missed,
    number,
    simulated,
)
from judged_picture import plot_judged
from matplotlib.figure import Figure
from reversal_pictures import plot_run, small_png

from vttig_jax.base.files.text_tables import text_table
from vttig_jax.control.simulation.result import Simulation

BEGIN, END = "<!-- reversals: begin -->\n", "<!-- reversals: end -->\n"


def tables() -> str:
    """All tables as Markdown, as the script prints them and the README shows them."""
    return markdown(
        ("TE of whole runs beside Table 3, in degrees", _run_table()),
        ("The reversals, simulated", _reversal_table()),
        ("What is left and what is closed too far, beside the closed forms", _missed_table()),
        ("The paper's controller at turns all over the hunting period", _everywhere_table()),
        (f"100 rpm with {HIGH_DRAG_NM:g} N·m of dry friction", _drag_table()),
    )


def _run_table() -> str:
    rows = []
    for run in experiments():
        rows.append((f"{run}, Fig. {run.figure}", *[""] * 6))
        for source in run.printed:
            rows.append(_printed_row(run, source, "without_control"))
        rows.append(_simulated_row(run, "none"))
        for source in run.printed:
            rows.append(_printed_row(run, source, "with_control"))
        rows += [_simulated_row(run, name) for name in CONTROLLERS[1:]]
    headers = ["", "mean", "max", "min", "range", "backlash", "as read"]
    return text_table(rows, headers)


def _printed_row(run: Experiment, source: str, control: str) -> tuple[str | None, ...]:
    table = _printed(run)
    mean, high, low = table[control][source]
    jump = table["backlash_deg"][source] if control == "without_control" else None
    name = f"printed: {source}, {control.replace('_', ' ')}"
    return name, *_four(mean, high, low), _shown(jump, 4), None


def _printed(run: Experiment) -> dict[str, Any]:
    return next(r for r in PRINTED["table_3"] if r["speed_rpm"] == run.speed_rpm)


def _simulated_row(run: Experiment, controller: str) -> tuple[str | None, ...]:
    mean, high, low = (number(run, controller, f"te_{name}_deg") for name in ("mean", "max", "min"))
    jump = number(run, controller, "jump_deg")
    read = -number(run, controller, "jump_paper_deg")
    name = f"simulated here: {controller}"
    return name, *_four(mean, high, low), _shown(jump, 4), _shown(read, 4)


def _four(mean: float, high: float, low: float) -> list[str]:
    return [f"{value:+.4f}" for value in (mean, high, low)] + [f"{high - low:.4f}"]


def _reversal_row(found: Simulation) -> list[str | None]:
    metrics = found.metrics
    numbers = {name: value for name, value in metrics.items() if isinstance(value, float)}
    delay = numbers.get("detection_delay_s")
    return [
        _shown(numbers["residual_gap_deg"], 5),
        _shown(numbers["jump_deg"], 5),
        _shown(found.to_json()["crossing_deg"], 1),
        _shown(numbers["axial_step_deg"], 5),
        _shown(numbers.get("detection_deg"), 2),
        None if delay is None else _shown(1e3 * delay, 0),
        _shown(numbers["interference_mm"], 4),
        found.outcome,
    ]


_REVERSAL = [
    "",
    ("left at turn", "°"),
    ("jump", "°"),
    ("met at", "°"),
    ("axial step", "°"),
    ("closes at", "°"),
    ("delay", "ms"),
    ("too far", "mm"),
    "outcome",
]


def _reversal_table() -> str:
    rows = []
    for run in experiments():
        rows.append((str(run), *[""] * 8))
        rows += [(name, *_reversal_row(simulated(run, name))) for name in CONTROLLERS]
    return text_table(rows, _REVERSAL)


def _missed_table() -> str:
    rows = []
    for run in experiments():
        rows.append((str(run), *[""] * 7))
        for controller in CONTROLLERS[1:]:
            ahead = judged_ahead(run, controller)
            by = ahead if controller == "acceleration" else 0.0
            closed = missed(np.array([run.reversal_deg]), by)
            rows.append(
                (
                    controller,
                    _shown(ahead, 2),
                    _shown(float(backlash(np.array([run.reversal_deg - by]))[0]), 5),
                    _shown(closed.left_deg[0], 5),
                    _shown(number(run, controller, "residual_gap_deg"), 5),
                    _shown(closed.over_mm[0], 4),
                    _shown(closed.over_on_the_way_mm[0], 4),
                    _shown(number(run, controller, "interference_mm"), 4),
                )
            )
    headers = [
        "",
        ("before the turn", "°"),
        ("by", "°"),
        ("left", "°"),
        ("simulated", "°"),
        ("too far at turn", "mm"),
        ("on the way", "mm"),
        ("simulated", "mm"),
    ]
    return text_table(rows, headers)


def _everywhere_table() -> str:
    turns = np.arange(360.0 * PAIR.hunting_turns)
    rows = []
    for run in {run.speed_rpm: run for run in reversed(experiments())}.values():
        ahead = judged_ahead(run, "acceleration")
        found = missed(turns, ahead, 25)
        rows.append(
            (
                f"{run.speed_rpm} rpm",
                _shown(ahead, 1),
                _shown(found.left_deg.mean(), 5),
                _shown(found.left_deg.max(), 5),
                f"{np.mean(found.over_mm > 0):.0%}",
                f"{np.mean(found.over_on_the_way_mm > 0):.0%}",
                _shown(found.over_on_the_way_mm.max(), 3),
            )
        )
    headers = [
        "",
        ("before the turn", "°"),
        ("left on average", "°"),
        ("at most", "°"),
        "too far at turn",
        "on the way",
        ("at most", "mm"),
    ]
    return text_table(rows[::-1], headers)


def _drag_table() -> str:
    rows = []
    for run in experiments():
        if run.speed_rpm == 100:
            rows.append((str(run), *[""] * 8))
            rows += [
                (name, *_reversal_row(simulated(run, name, HIGH_DRAG_NM))) for name in CONTROLLERS
            ]
    return text_table(rows, _REVERSAL)


def _shown(value: float | None, places: int) -> str | None:
    """A number with so many decimals, and no −0."""
    return None if value is None else f"{round(float(value), places) + 0.0:.{places}f}"


def pictures() -> dict[str, bytes]:
    """PNG by file name: every run like Figs. 16–20, and the backlash the controller closes by."""
    drawn = {f"fig_{run.figure}.png": small_png(run_picture(run)) for run in experiments()}
    return drawn | {"judged.png": small_png(judged_picture())}


def run_picture(run: Experiment) -> Figure:
    """One run without and with control, with what Table 3 prints of it."""
    spans = {}
    for name, control in (("none", "without_control"), ("acceleration", "with_control")):
        _, high, low = _printed(run)[control][run.printed[0]]
        spans[name] = (low, high)
    runs = {name: simulated(run, name) for name in CONTROLLERS}
    words = f"Table 3, {run.printed[0]}: min to max"
    return plot_run(runs, f"{run}, as Fig. {run.figure}", spans, words)


def judged_picture() -> Figure:
    """The backlash that the paper's controller closes by, and that of the turns."""
    places = [
        (str(run), float(run.reversal_deg), judged_ahead(run, "acceleration"))
        for run in experiments()
    ]
    margin = SCENARIO.judgement.margin_mm * degrees_per_mm()
    return plot_judged(backlash, places, 360.0 * PAIR.hunting_turns, margin)


def main(argv: list[str] | None = None) -> None:
    """Print the tables; with `--write` renew README.md and the pictures as well."""
    parser = argparse.ArgumentParser(description="The paper's reversals simulated.")
    parser.add_argument("--write", action="store_true", help="renew README.md and the pictures")
    text = tables()
    if parser.parse_args(argv).write:
        renew(HERE, (BEGIN, END), text, pictures())
    print(text)


if __name__ == "__main__":
    main()
