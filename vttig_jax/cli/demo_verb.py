"""`vttig demo`: the paper's rig, simulated, fitted and mapped, beside the truth."""

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .fit_verb import run_figures
from .map_verb import csv_text, map_record, map_table
from .options import verb
from .output import Output
from .run_file import Run

if TYPE_CHECKING:
    from ..identify.result import Fit
    from ..kinematics.backlash_map import BacklashMap
    from ..logs.encoder_log import EncoderLog
    from ..rig.synthetic import SyntheticRig

_STEPS = ("simulate", "fit", "map", "draw and write")


@verb("demo", example="vttig demo --out demo")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for log, fit, map, pictures.")
@click.option("--overwrite", is_flag=True, help="Replace the demo that is in --out.")
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Of orders, phases and noise.")
def command(output: Output, out: Path | None, overwrite: bool, seed: int) -> None:
    """Simulate the rig of the paper, fit it, map it, and show the result beside its Table 2.

    60 rpm to 7560° and back with a dwell of 2 s, 90 000 counts a turn, 0.1 % speed ripple. The
    measured logs of the paper were never published, so the log is simulated through the exact
    kinematics with plausible mesh and pitch errors, encoder errors and noise. Nothing is written
    without --out.
    """
    import vttig_jax

    from ..identify.fit import fit
    from ..identify.mapping import backlash_map
    from ..kinematics.backlash_map import BacklashMap
    from ..rig.paper import paper_rig

    vttig_jax.enable_x64()
    with output.progress(len(_STEPS), "simulate") as bar:
        rig = paper_rig(seed)
        log = rig.log(seed)
        _next(bar, "fit")
        result = fit(log, rig.pair)
        _next(bar, "map")
        grid = backlash_map(result)
        truth = BacklashMap(rig.flank_model(), None, rig.pair)
        table, record = _map(result, grid)
        text = _report(rig, result, grid, truth)
        _next(bar, "draw and write")
        if out is not None:
            _write(out, overwrite, log, rig, result, table, record)
        bar.update(1)
    hint = (
        f"written to {out}; try `vttig inspect {out / 'log.csv'} --pair {out / 'pair.toml'}`."
        if out is not None
        else "`vttig demo --out DIR` keeps the log, the fit, the map and the pictures."
    )
    output.emit(result.to_json(), f"{text}\n\n{hint}")


def _next(bar: Any, step: str) -> None:
    bar.update(1)
    bar.set_description(step)


def _map(result: "Fit", grid: "BacklashMap") -> tuple[Any, dict[str, Any]]:
    turns = float(grid.pair.hunting_turns)
    table = map_table(grid, 1.0, turns)
    return table, map_record(result, grid, 1.0, turns, len(table), Path("map.csv"))


def _report(rig: "SyntheticRig", result: "Fit", grid: "BacklashMap", truth: "BacklashMap") -> str:
    """Table of truth and fit, and the map's error against the true map."""
    import numpy as np

    from ..base.angles import difference_deg
    from ..base.tables import key_values, text_table
    from ..base.units import DEG, REV

    rows = []
    for name, true in _truths(rig).items():
        parameter = result.parameters[name]
        value, std = parameter.value, parameter.std
        if value is None or not std:
            rows.append([name, f"{true:g}", "–", "", "", parameter.unit])
            continue
        off = value - true
        if parameter.unit == "deg" and "phase" in name:
            off = float(difference_deg(value, true))
        places = max(0, int(1 - np.floor(np.log10(std))))
        rows.append(
            [
                name,
                f"{true:g}",
                f"{value:.{places}f}",
                f"{std:.{places}f}",
                f"{off / std:+.1f}",
                parameter.unit,
            ]
        )
    table = text_table(rows, ["parameter", "truth", "fit", "std", "off in std", "unit"])
    angles = np.linspace(0, rig.pair.hunting_turns * REV, 16_001)[:-1]
    true_map = truth.over(angles)
    error = np.sqrt(np.mean((grid.over(angles) - true_map) ** 2)) / DEG
    first = np.sqrt(np.mean((grid.first_order_over(angles) - true_map) ** 2)) / DEG
    maps = key_values(
        [
            ("order-complete map", f"{error:.5f}° rms from the true one"),
            ("first-order map", f"{first:.5f}° rms from the true one"),
            ("smallest gap", f"{grid.smallest}; true {truth.smallest.backlash / DEG:.5f}°"),
            ("largest gap", f"{grid.largest}; true {truth.largest.backlash / DEG:.5f}°"),
            ("safe axial closing", f"{grid.safe_closing_mm:.4f} mm"),
        ],
        title="backlash over the hunting period of 5760°",
    )
    head = key_values(
        [
            ("log", f"{result.source} (simulated: the paper's logs were never published)"),
            ("samples", f"{result.samples['read']} at {rig.rate_hz:g} Hz"),
            ("outcome", result.outcome),
            ("residual", f"{result.residual_rms_deg:.5f}° rms"),
        ],
        title="the paper's rig (Tables 1 and 2)",
    )
    return f"{head}\n\n{table}\n\n{maps}"


def _truths(rig: "SyntheticRig") -> dict[str, float]:
    e = rig.eccentricities
    return {
        "driving_eccentricity_mm": float(e.driving_mm),
        "driving_phase_deg": float(e.driving_phase_deg),
        "driven_eccentricity_mm": float(e.driven_mm),
        "driven_phase_deg": float(e.driven_phase_deg),
        "constant_backlash_deg": float(e.constant_backlash_deg),
        "driving_encoder_arcsec": rig.driving_encoder.amplitude_arcsec,
        "driving_encoder_phase_deg": rig.driving_encoder.phase_deg,
        "driven_encoder_arcsec": rig.driven_encoder.amplitude_arcsec,
        "driven_encoder_phase_deg": rig.driven_encoder.phase_deg,
    }


def _write(
    out: Path,
    overwrite: bool,
    log: "EncoderLog",
    rig: "SyntheticRig",
    result: "Fit",
    table: Any,
    record: dict[str, Any],
) -> None:
    """A run folder that the other verbs can go on with."""
    import hashlib

    from ..base.jsonio import dumps
    from ..base.runfolder import RunFolder
    from ..identify.store import fit_arrays
    from ..pair.gears import pair_spec
    from ..pair.spec import spec_table

    spec = pair_spec(rig.pair)
    data = log_csv(log)
    digest = hashlib.sha256(data.encode()).hexdigest()
    run = Run((out / "log.csv",), spec, sha256=(digest,))
    with RunFolder(out, overwrite=overwrite, results=("fit.json",)) as folder:
        folder.write_text("log.csv", data)
        folder.write_toml("pair.toml", spec_table(spec))
        folder.write_toml("run.toml", run.table(out))
        folder.write_npz("summary.npz", **fit_arrays(result))
        folder.write_text("map.csv", csv_text(table))
        folder.write_text("map.json", dumps(record) + "\n")
        for name, picture in run_figures(result).items():
            folder.write_bytes(f"figures/{name}", picture)
        folder.write_text("fit.json", dumps(result.to_json()) + "\n")


def log_csv(log: "EncoderLog") -> str:
    """A log of two counting encoders as CSV."""
    import numpy as np

    assert log.driven is not None  # a synthetic rig logs both shafts
    buffer = io.StringIO()
    columns = np.stack([log.time, log.driving.reading, log.driven.reading], axis=1)
    header = "time_s,driving_counts,driven_counts"
    np.savetxt(buffer, columns, fmt=["%.7f", "%d", "%d"], delimiter=",", header=header, comments="")
    return buffer.getvalue()
