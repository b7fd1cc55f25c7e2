"""`vttig demo`: simulate the rig of the paper, fit it, and compare the fit with the true values."""

import hashlib
import io
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click
import numpy as np
import tomli_w

from ... import report as reports
from ...base.angles import difference_deg
from ...base.errors import UsageError
from ...base.files.text_tables import decimals, key_values, text_table
from ...base.units import DEG
from ...pair.pair_file import stated_table
from ...runs.fit_run import banded_of, record_of, save_fit, write_report
from ...runs.run_file import CHECKPOINT
from ..options import refuse_results, verb
from ..output import Output, sampling_bar

if TYPE_CHECKING:
    from ...logs.encoder_log import EncoderLog
    from ...posterior.summary.bands import BandedMap
    from ...posterior.summary.posterior import Posterior
    from ...rig.synthetic import SyntheticRig


@verb("demo", example="vttig demo --out demo")
def command(
    output: Output,
    *,
    out: Annotated[Path | None, "Folder for log, fit, map, pictures."],
    overwrite: Annotated[bool, "Replace the demo that is in --out."],
    seed: Annotated[int, click.IntRange(min=0), "Of orders, phases and noise."] = 0,
    steps: Annotated[
        int | None,
        click.IntRange(min=40),
        "Number of steps to sample; by default until the sampler has converged.",
    ],
) -> None:
    """Simulate the rig of the paper, identify it, and compare the result with the true values.

    The true values are those of Table 2. The driving shaft turns at 60 rpm to 7560° and back, with
    a dwell of 2 s and a speed ripple of 0.1 %; the encoders have 90 000 counts per turn. The
    measured logs of the paper were never published, so the log is simulated by the exact kinematics
    with plausible mesh and pitch errors, encoder errors and noise, and both encoders are read at
    the same instant. The command fits the log, samples the posterior and computes the backlash map.
    Without --out no file is written.
    """
    from ...identify.identification import fit
    from ...posterior.sampler import sample
    from ...rig.paper import paper_rig

    if not overwrite:
        refuse_results(out, (CHECKPOINT, "fit.json"), "add --overwrite to replace it")
    with output.progress(2, "simulate") as bar:
        rig = paper_rig(seed)
        log = rig.log(seed)
        bar.update(1)
        bar.set_description("fit")
        result = fit(log, rig.pair, delay="off")  # the rig reads both encoders at once
        if out is not None:
            # A run folder that the other verbs can use.
            data = log_csv(log)
            digest = hashlib.sha256(data.encode()).hexdigest()
            run = replace(record_of(result), logs=(out / "log.csv",), sha256=(digest,))
            beside = {"log.csv": data, "pair.toml": tomli_w.dumps(stated_table(run.spec))}
            save_fit(result, out, overwrite=overwrite, record=run, beside=beside)
    with sampling_bar(output) as follow:
        posterior = sample(
            result,
            seed=seed,
            steps=steps,
            checkpoint=None if out is None else out / CHECKPOINT,
            overwrite=overwrite,
            progress=follow,
        )
    banded = banded_of(posterior) if out is None else write_report(out, posterior)
    assert banded is not None  # the rig of the paper turns in both directions
    hint = "`vttig demo --out DIR` keeps the log, the fit, the draws, the map and the pictures."
    if out is not None:
        hint = (
            f"written to {out}; try `vttig inspect {out / 'log.csv'} --pair {out / 'pair.toml'}`."
        )
        try:
            hint += f"\n\nreport: {reports.write_report(out, overwrite=overwrite).record['report']}"
        except UsageError as missing:  # the extra is not installed
            hint += f"\n\n{missing.message}"
    output.emit(posterior.to_json(), f"{_report(rig, posterior, banded)}\n\n{hint}")


def _report(rig: "SyntheticRig", found: "Posterior", banded: "BandedMap") -> str:
    """Return the report: table of true, fitted and sampled values, and comparison of the maps."""
    result = found.fit
    rows = [_row(name, true, found) for name, true in _truths(rig).items()]
    heading = ["parameter", "truth", "fit", "std", "off in std", "sampled 95 %", "unit"]
    head = key_values(
        [
            ("log", f"{result.source} (simulated: the paper's logs were never published)"),
            ("samples", f"{result.samples['read']} at {rig.rate_hz:g} Hz"),
            ("outcome", result.outcome),
            ("residual", f"{result.residual_rms_deg:.5f}° rms"),
            ("sampler", str(found.diagnosis)),
        ],
        title="the paper's rig (Tables 1 and 2)",
    )
    return f"{head}\n\n{text_table(rows, heading)}\n\n{_map_text(rig, banded)}"


def _row(name: str, true: float, found: "Posterior") -> list[str]:
    parameter, drawn = found.fit.parameters[name], found.parameters[name]
    value, std = parameter.value, parameter.std
    if value is None or not std or drawn.low95 is None:
        return [name, f"{true:g}", "–", "", "", "", parameter.unit]
    off = value - true
    if parameter.unit == "deg" and "phase" in name:
        off = float(difference_deg(value, true))
    number = f"{{:.{decimals(std, value)}f}}".format
    span = f"{number(drawn.low95)} … {number(drawn.high95)}"
    return [
        name,
        f"{true:g}",
        number(value),
        number(std),
        f"{off / std:+.1f}",
        span,
        parameter.unit,
    ]


def _map_text(rig: "SyntheticRig", banded: "BandedMap") -> str:
    """Return a text that compares the backlash map of the posterior with the true map."""
    from ...kinematics.backlash_map import BacklashMap

    grid, truth = banded.map, BacklashMap(rig.flank_model(), None, rig.pair)
    angles, band = banded.driving_angle, banded.band
    true_map = truth.over(angles)
    error = np.sqrt(np.mean((band.centre - true_map) ** 2)) / DEG
    first = np.sqrt(np.mean((banded.first_order - true_map) ** 2)) / DEG
    inside = (true_map >= band.low_simultaneous) & (true_map <= band.high_simultaneous)
    width = np.median(band.high_simultaneous - band.low_simultaneous) / 2 / DEG
    return key_values(
        [
            ("map with all orders", f"{error:.5f}° rms from the true one"),
            ("map of first orders", f"{first:.5f}° rms from the true one"),
            (
                "95 % band of the whole map",
                f"± {width:.4f}°, {'holds' if inside.all() else 'does not hold'} the true map",
            ),
            ("largest gap", f"{grid.largest}; true {truth.largest.backlash / DEG:.5f}°"),
            *banded.smallest.rows(),
            ("true smallest gap", f"{truth.smallest}"),
        ],
        title="backlash over 5760°, until the same teeth meet again (hunting period)",
    )


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


def log_csv(log: "EncoderLog") -> str:
    """Return a log as CSV with the time in s and the readings of both encoders in counts."""
    assert log.driven is not None  # a synthetic rig logs both shafts
    buffer = io.StringIO()
    columns = np.stack([log.time, log.driving.reading, log.driven.reading], axis=1)
    header = "time_s,driving_counts,driven_counts"
    np.savetxt(buffer, columns, fmt=["%.7f", "%d", "%d"], delimiter=",", header=header, comments="")
    return buffer.getvalue()
