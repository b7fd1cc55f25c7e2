"""Flank models of a simulation, read from run folders and map files.

They are read here, so that the simulator does not import the modules of fits and posteriors.
"""

import json
import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicSpline

from ..base.errors import InputError, ScenarioError, VttigError
from ..base.logger import LOGGER
from ..base.units import ARCSEC, DEG, REV
from ..control.scenario.spec import ScenarioSpec, lower_maps, names_of_maps
from ..control.simulation.prepare import Maps, load_gears
from ..identify.backlash import contact_map
from ..identify.result import require_rig
from ..kinematics.backlash_map import BacklashMap
from ..kinematics.flank_model import FlankModel
from ..kinematics.flank_table import FlankTable
from ..kinematics.harmonic import OrderModel
from ..pair.gear_pair import Drive, Eccentricities, GearPair, load_pair
from ..posterior.summary.bands import MOST_ROWS, Band, streamed_band
from ..posterior.summary.gap_draws import PER_PERIOD, GapDraws
from ..posterior.summary.posterior import gap_draws
from .run import Run


def opened_maps(
    spec: ScenarioSpec,
    folder: Path,
    pair: GearPair | Drive | None = None,
    given: dict[str, FlankModel] | None = None,
) -> tuple[GearPair | Drive, Maps]:
    """Return the gears of a scenario or sweep, and the flank models of the maps that it names.

    A sweep with `rig` also gets the whole maps of its posterior draws.

    **Arguments**
    - `folder`: folder for relative paths. - `pair`: gears instead of those that the file names.
    - `given`: flank models of names that are no files.

    **Raises** `ScenarioError` for a map that cannot be read or belongs to other gears.
    """
    named = dict(given or {})
    names = [name for name in names_of_maps(spec) if name not in named]
    runs = {name: Run(folder / name) for name in names if (folder / name).is_dir()}
    if pair is None and spec.pair:
        pair = load_gears(folder / spec.pair)
    elif pair is None and not runs:
        raise ScenarioError("missing; name the pair file, relative to this file.", where="pair")
    draws = None
    sources = {name: (name, "mean") for name in names} | lower_maps(spec)
    for believed, (name, gap) in sources.items():
        try:
            if name in (given or ()):
                raise InputError("it has no draws; name a run folder or its map.csv.")
            if name not in runs:
                assert pair is not None
                named[believed] = read_map_file(folder / name, pair, gap)
                continue
            run = runs[name]
            pair = run.pair if pair is None else pair
            _require_same_gears(run.pair, pair, folder / name)
            if believed == name and spec.sweep and spec.rig and name == spec.rig.run:
                draws = _drawn_models(run, spec)
            named[believed] = _run_model(run, spec.constant_backlash_deg, gap)
        except VttigError as error:
            message = (
                error.message if error.where in ("", name) else f"{error.where}: {error.message}"
            )
            raise ScenarioError(message, where=f"map {believed!r}") from None
    assert pair is not None
    return pair, Maps(named, *(draws or (None, 0)))


def _run_model(run: Run, constant_backlash_deg: float | None, gap: str) -> FlankModel:
    """Return both flanks of a run folder: the mean of the draws, or else the fit.

    With another `gap` than "mean", flank B lies above flank A by this edge of the band.
    """
    posterior = run.drawn if constant_backlash_deg is None else None
    if gap != "mean" and posterior is None:
        raise InputError(
            f"no band: it takes draws (`vttig sample {run.folder}`) with their own constant"
            ' backlash; without them write controller_gap = "mean".'
        )
    if posterior is not None:
        draws = gap_draws(posterior)
        if gap == "mean":
            return draws.mean_model
        angle, band = _band(draws)
        first = np.asarray(draws.mean_model.transmission_error(angle, "A"))
        return _splines(angle, [first, first + band.edges[gap]], draws.pair)
    if isinstance(run.pair, Drive):
        return _orders_model(run, constant_backlash_deg)
    return contact_map(run.fit, constant_backlash_deg=constant_backlash_deg)[1]


def lowered_map(run: Run, gap: str) -> tuple[BacklashMap, float]:
    """Return the map of the posterior mean that is nowhere above an edge of its band.

    For a header of harmonics: it is the mean less the largest distance to this edge, which is
    returned too, rad.
    """
    draws = gap_draws(run.drawn or run.posterior)
    _, band = _band(draws)
    distance = float(np.max(band.centre - band.edges[gap]))
    mean = draws.mean_model
    lowered = replace(mean, offset=mean.offset - np.array([0.0, distance]))
    return BacklashMap(lowered, None, draws.pair), distance


def _band(draws: GapDraws) -> tuple[Any, Band]:
    """Return driving angles (rad) over the hunting period, and the band of the gap there."""
    step = REV / (PER_PERIOD * math.ceil(draws.mean_model.highest_order))
    rows = min(round(draws.pair.hunting_turns * REV / step), MOST_ROWS)
    angle = step * np.arange(rows)
    return angle, streamed_band(draws.chunks(angle))


def _orders_model(run: Run, constant_backlash_deg: float | None) -> FlankModel:
    """Return the flanks of a drive from the orders in its `fit.json`.

    The mean of flank A is zero. Flank B stands the constant backlash above it, or else the gap over
    the angles covered; an unmeasured flank has the orders of the other one.
    """
    try:
        fit = json.loads((run.folder / "fit.json").read_text("utf-8"))
        rows = [row for row in fit["orders"] if float(row["order"]).is_integer()]
        gaps = fit["parameters"]["constant_backlash_deg"], fit["checks"]["gap_over_angles_covered"]
        measured = {flank: flank for flank in fit["flanks"]}
        given = [gap for gap in gaps if gap and gap["determined"]]
        waves = {
            (row["shaft"], int(row["order"]), row["flank"]): row["amplitude_arcsec"]
            * ARCSEC
            * np.exp(1j * (row["phase_deg"] or 0.0) * DEG)
            for row in rows
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"fit.json is missing or damaged ({type(error).__name__}); make it again with `vttig"
            " fit … --overwrite`."
        ) from None
    lines: dict[str, float] = {}
    for row in fit["orders"]:
        if row not in rows:
            name = f"{row['order']:g}"
            lines[name] = max(row["amplitude_arcsec"], lines.get(name, 0.0))
    if lines:
        left_out = ", ".join(f"{name} ({amplitude:.3g}″)" for name, amplitude in lines.items())
        LOGGER.warning(
            "%s: orders without a fixed place on the gears left out, so that the output has this"
            " error too: %s",
            run.folder,
            left_out,
        )
    if len(measured) == 1:
        LOGGER.warning("%s: the unmeasured flank has the orders of the other one", run.folder)
    gap_deg = constant_backlash_deg
    if gap_deg is None and given:
        gap_deg, low, high = (given[0][name] for name in ("value", "low95", "high95"))
        if low is not None and low <= 0:
            LOGGER.warning(
                "%s: the gap %.5f° (%.5f … %.5f°) may be zero; give one that was measured in"
                " another way (constant_backlash_deg)",
                run.folder,
                gap_deg,
                low,
                high,
            )
    if gap_deg is None:
        raise InputError(
            f"the log has flank {' and '.join(measured)} and no gap; record both directions, or"
            " give the gap: constant_backlash_deg = …, or --set constant_backlash_deg=…."
        )
    terms = sorted({(shaft, order) for shaft, order, _ in waves})
    flanks = [measured.get(flank, next(iter(measured))) for flank in ("A", "B")]
    phasors: Any = np.array(
        [[waves.get((*term, flank), 0.0) for term in terms] for flank in flanks], complex
    ).reshape(2, len(terms))  # a sin(x + p) = Im[a exp(jp) exp(jx)]
    orders = [(order, 0) if shaft == "driving" else (0, order) for shaft, order in terms]
    offset, cosine, sine = map(
        jnp.asarray, (np.array([0.0, gap_deg * DEG]), phasors.imag, phasors.real)
    )
    return OrderModel(np.asarray(float(run.pair.ratio)), tuple(orders), offset, cosine, sine)


def _drawn_models(run: Run, spec: ScenarioSpec) -> tuple[FlankModel, int]:
    """Return the flank models of posterior draws, stacked along a first axis, and their number."""
    assert spec.rig is not None
    if (posterior := run.drawn) is None:
        raise InputError(
            f"there are no draws in {run.folder}; make them with `vttig sample {run.folder}`, or"
            ' write plant_map = "RUN" in place of `rig` for a sweep with the fit.'
        )
    if spec.constant_backlash_deg is not None:
        raise ScenarioError(
            "given, but every draw of `rig` has a backlash of its own; remove one of them.",
            where="constant_backlash_deg",
        )
    draws, (count, seed) = gap_draws(posterior), spec.rig.chosen
    if count > len(draws.offset):
        raise InputError(
            f"rig.draws asks for {count} draws, but the posterior holds {len(draws.offset)}; take"
            " fewer, or sample longer."
        )
    chosen = np.sort(np.random.default_rng(seed).choice(len(draws.offset), count, replace=False))
    return posterior.model(chosen), count


def read_map_file(path: Path, pair: GearPair | Drive, gap: str = "mean") -> FlankModel:
    """Return the flanks of a map file, such as `vttig map --out map.csv` writes it.

    The rows stand at even steps of `driving_deg`. The flanks are `te_a_deg` and `te_b_deg`; a file
    with `backlash_deg` alone has a perfect flank A. Another `gap` than "mean" is a column of its
    own, such as `low95_deg`. Cubic splines pass through all rows. The map is periodic if the rows
    cover the hunting period.

    **Raises** `InputError` for a file that is no such table.
    """
    try:
        with warnings.catch_warnings(action="ignore"):  # of an empty file
            table = np.genfromtxt(path, delimiter=",", names=True, dtype=float, encoding="utf-8")
    except (OSError, ValueError, IndexError) as error:
        why = "its lines do not have the same number of cells"
        if isinstance(error, OSError):
            why = "there is no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise InputError(
            f"no map can be read here: {why}; name a run folder, or the CSV of `vttig map`."
        ) from None
    columns = table.dtype.names or ()
    flanks, given, mean = ("te_a_deg", "te_b_deg"), set(columns), gap == "mean"
    single = "backlash_deg" if mean else f"{gap}_deg"
    both = mean and set(flanks) <= given
    if "driving_deg" not in given or not (both or single in given):
        raise InputError(
            f"a map has the columns driving_deg and {'te_a_deg, te_b_deg or ' * mean}{single}, but"
            f" this file has {', '.join(columns) or 'none'}; write it with `vttig map --out`"
            f"{'' if mean else ' after `vttig sample`'}."
        )
    angle = np.atleast_1d(table["driving_deg"]) * DEG
    if both:
        errors = [np.atleast_1d(table[name]) * DEG for name in flanks]
    else:
        errors = [np.zeros(len(angle)), np.atleast_1d(table[single]) * DEG]
    if len(angle) < 4 or not np.all(np.isfinite([angle, *errors])):
        raise InputError(
            f"a map needs four rows or more, each with all numbers, but here are {len(angle)} rows"
            " or empty cells; write it with `vttig map --out`."
        )
    if np.max(np.abs(errors[1] - errors[0])) > 90 * DEG:
        raise InputError("the flanks of this map are more than 90° apart; its columns are in deg.")
    step = (angle[-1] - angle[0]) / (len(angle) - 1)
    if not (step > 0 and np.allclose(np.diff(angle), step, rtol=1e-6)):
        raise InputError(
            "the rows of a map stand at even, rising steps of driving_deg, but these do not; write"
            " it with `vttig map --out`."
        )
    return _splines(angle, errors, pair)


def _splines(angle: Any, errors: list[Any], pair: GearPair | Drive) -> FlankModel:
    """Return the flanks with cubic splines through both errors (rad) at even driving angles."""
    step = (angle[-1] - angle[0]) / (len(angle) - 1)
    turns = len(angle) * step / REV / pair.hunting_turns
    periodic = bool(abs(turns - round(turns)) < 1e-6 and round(turns) >= 1)
    nodes = []
    if periodic:
        angle = np.append(angle, angle[0] + len(angle) * step)
        errors = [np.append(error, error[0]) for error in errors]
    for error in errors:
        spline = CubicSpline(angle, error, bc_type="periodic" if periodic else "not-a-knot")
        nodes += [error, step * spline(angle, 1)]
    return FlankTable(
        nodes=np.stack(nodes, axis=1),
        ratio=float(pair.ratio),
        start=angle[0],
        step=step,
        closing=np.zeros(2),
        first=np.asarray(0),
        intervals=len(angle) - 1,
        periodic=periodic,
    )


def fitted_rig(folder: Path, pair: Path) -> Eccentricities:
    """Return the rig of a run folder: the mean of its posterior, or the fit without a posterior.

    **Raises** `InputError` if the gears of the run differ from those in the pair file.
    """
    run = Run(folder)
    fit = run.fit
    if pair.exists():  # the code that uses the pair file reports its errors
        _require_same_gears(fit.pair, load_pair(pair), folder, str(pair))
    require_rig(fit)
    return (run.drawn or fit).eccentricities()


def _require_same_gears(
    fitted: GearPair | Drive, pair: GearPair | Drive, folder: Path, where: str = ""
) -> None:
    """Raise `InputError` if `pair` differs from the gears of the fit in `folder`."""
    compared = [("ratio", "", lambda one: float(one.ratio))]
    if isinstance(pair, GearPair) and isinstance(fitted, GearPair):
        compared = [
            ("teeth", "", lambda one: (one.driving.teeth, one.driven.teeth)),
            ("module", " mm", lambda one: one.module_mm),
            ("pressure angles", "°", lambda one: one.pressure_angles_deg),
            ("centre distance", " mm", lambda one: one.centre_distance_mm),
        ]
    for what, unit, of in compared:
        here, there = (np.ravel(np.asarray(of(one), float)) for one in (pair, fitted))
        if not np.allclose(here, there, rtol=1e-9):
            seen, known = ("/".join(f"{x:g}" for x in dict.fromkeys(v)) for v in (here, there))
            raise InputError(
                f"not the gears of the run in {folder}: {what} {seen}{unit} here, {known}{unit}"
                " there; name the pair file of that run, or give eccentricities of these gears.",
                where=where,
            )
