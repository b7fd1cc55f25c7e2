"""Files of a fit: `fit.json` for people, `summary.npz` for the next command; no pickles."""

import hashlib
import io
import json
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import msgspec
import numpy as np

from ..base.errors import InputError, UsageError
from ..base.files.atomic_write import settle_if_free
from ..base.files.limits import MemoryBudget, read_regular
from ..kinematics.flank_error import FlankError
from ..kinematics.harmonic import OrderModel
from ..kinematics.te_curve import TECurve
from ..model.columns import Column
from ..model.density import Compressed, Solved
from ..model.functionals import Posterior, Readings
from ..model.mixed_fit import MixedFit
from ..model.parameter import Parameter
from ..model.problem import Problem
from ..model.rows import Wave
from ..model.scope import Scope
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import Flank, HarmonicOrders
from .given import StoredModel
from .result import Fit
from .turn_averages import Measured

_PLAIN = ("source", "sha256", "outcome", "flanks", "samples", "zero", "zero_readings", "orders")
_PLAIN += ("conditional_on", "noise", "residual_rms_deg", "checks", "findings", "logs")
"""Fields of a fit that stand in `fit.json` as they are."""

_SOLVED, _COMPRESSED, _MEASURED = "solved_", "compressed_", "measured_"
_READINGS = ("readings_rows", "readings_values", "readings_variance")
_SIDES: dict[Flank, int] = {"A": 1, "B": -1}
"""Flank → its number in the files."""


def fit_arrays(fit: Fit) -> dict[str, np.ndarray]:
    """Return the arrays that store a fit, by name.

    They hold its harmonics, parameters with covariance, curves and residuals, and its compressed
    logs with the largest density, from which sampling goes on.
    """
    curves = fit.curves
    return {
        **_core_arrays(fit.core),
        **({} if fit.measured is None else _parts(_MEASURED, fit.measured)),
        "terms": np.asarray(fit.model.terms, np.int64).reshape(-1, 2),
        "offset": np.asarray(fit.model.offset),
        "cosine": np.asarray(fit.model.cosine),
        "sine": np.asarray(fit.model.sine),
        "names": np.asarray(fit.covariance_names),
        "values": fit.values,
        "covariance": fit.covariance,
        "curve_flanks": np.asarray([curve.flank for curve in curves]),
        "curve_lengths": np.asarray([len(curve) for curve in curves], np.int64),
        "driving_angle": _concatenated([curve.driving_angle for curve in curves]),
        "transmission_error": _concatenated([curve.transmission_error for curve in curves]),
        "time": _concatenated([curve.time for curve in curves]),
        "residual": _concatenated(list(fit.residuals)),
    }


def _core_arrays(core: MixedFit) -> dict[str, np.ndarray]:
    """Return the posterior of a fit as arrays; names, orders and scope are one JSON text."""
    posterior, problem, scope = core.posterior, core.posterior.problem, core.scope
    text = {
        "columns": problem.columns,
        "waves": [(w.shaft, w.order, w.driving, w.driven) for w in core.waves],
        "orders": core.orders,
        "flanks": [_SIDES[flank] for flank in scope.flanks],
        "levels": scope.levels,
        "nominal": scope.nominal,
        "turns": scope.turns,
        "speeds": scope.speeds,
        "counts": (core.passes, core.steps),
        "numbers": (problem.unit, core.delay_s, core.usual),
    }
    windows = np.asarray(problem.compressed.windows)
    return {
        "core": np.array(msgspec.json.encode(text, enc_hook=lambda x: x.tolist()).decode()),
        "covered": scope.covered,
        "bends": core.bends,
        "theta": posterior.theta,
        "natural": problem.natural,
        "start": problem.start,
        **dict(zip(_READINGS, map(np.asarray, posterior.readings or ()), strict=False)),
        **_parts(_SOLVED, posterior.at),
        **_parts(_COMPRESSED, problem.compressed),
        # every window is symmetric
        _COMPRESSED + "windows": windows[:, *np.triu_indices(windows.shape[-1])],
    }


def _parts(front: str, part: Any) -> dict[str, np.ndarray]:
    return {front + field.name: np.asarray(getattr(part, field.name)) for field in fields(part)}


def _of(kind: type, front: str, arrays: dict[str, np.ndarray]) -> dict:
    return {field.name: jnp.asarray(arrays[front + field.name]) for field in fields(kind)}


def _core(arrays: dict[str, np.ndarray], ratio: float) -> MixedFit:
    """Return the fit of `_core_arrays`, without rows and samples."""
    text = json.loads(str(arrays["core"]))
    unit, delay_s, *_, usual = text["numbers"]  # older runs have a number more
    size = len(arrays[_SOLVED + "beta"]) + 1
    upper = np.triu_indices(size)
    whole = np.zeros((len(arrays[_COMPRESSED + "windows"]), size, size))
    whole[:, *upper] = whole[:, *upper[::-1]] = arrays[_COMPRESSED + "windows"]
    arrays = arrays | {_COMPRESSED + "windows": whole}
    compressed = Compressed(**_of(Compressed, _COMPRESSED, arrays))
    solved = Solved(**_of(Solved, _SOLVED, arrays))
    columns = msgspec.convert(text["columns"], tuple[Column, ...])
    readings: Readings | None = None
    if _READINGS[0] in arrays:
        rows, values, variance = (arrays[name] for name in _READINGS)
        readings = Readings(rows, values, float(variance))
    problem = Problem(columns, compressed, arrays["natural"], arrays["start"], unit)
    return MixedFit(
        shafts=(),
        rows=(),
        waves=tuple(Wave(*wave) for wave in text["waves"]),
        posterior=Posterior(problem, arrays["theta"], solved, readings),
        delay_s=delay_s,
        bends=arrays["bends"],
        passes=text["counts"][0],
        steps=text["counts"][1],
        usual=usual,
        weights=None,
        scope=Scope(
            flanks=tuple(flank for flank in _SIDES if _SIDES[flank] in text["flanks"]),
            ratio=ratio,
            nominal=tuple(text["nominal"]),
            levels=tuple(text["levels"]),
            turns=text["turns"],
            covered=arrays["covered"],
            speeds=tuple(text["speeds"]),
        ),
        orders=msgspec.convert(text["orders"], HarmonicOrders),
    )


def arrays_digest(arrays: dict[str, np.ndarray]) -> str:
    """Return the SHA-256 of named arrays: of their names, types, shapes and values."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def read_fit(folder: str | Path, pair: GearPair | Drive, *, run: str | None = None) -> Fit:
    """Read the fit of a run folder; `pair` is the pair of its `run.toml`.

    `run` is the digest in that `run.toml`; with it, files of other runs are refused.

    **Raises** `UsageError` if the folder contains no fit, and `InputError` if the fit is damaged or
    of an older version, or its files belong to different runs.
    """
    folder = Path(folder)
    settle_if_free(folder)
    missing = [name for name in ("fit.json", "summary.npz") if not (folder / name).is_file()]
    if missing == ["summary.npz"]:
        raise UsageError(
            "only the report of the fit is here (fit.json), which `vttig simulate` can run with;"
            " its numbers (summary.npz), from which a map is made, are missing: make them again"
            f" from the log, `vttig fit --run {folder / 'run.toml'} --out …`.",
            where=str(folder),
        )
    if missing:
        raise UsageError(
            f"no fit here ({' and '.join(missing)} missing); make one with `vttig fit LOG --pair"
            f" PAIR --out {folder}`.",
            where=str(folder),
        )
    try:
        record = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
        arrays = _read_arrays(folder / "summary.npz")
        _require_whole(folder, record, arrays, run)
        return _assembled(record, arrays, pair)
    except (InputError, MemoryError):
        raise
    except PermissionError:
        raise InputError("no permission to read this fit.", where=str(folder)) from None
    except Exception as error:
        raise InputError(
            f"the fit in this folder is damaged ({type(error).__name__}: {error}); make it again"
            " with --overwrite.",
            where=str(folder),
        ) from None


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an archive, after a check that their declared sizes fit in memory."""
    data = read_regular(path)
    budget = MemoryBudget(str(path), len(data))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            budget.take(member.file_size)
    return dict(np.load(io.BytesIO(data), allow_pickle=False))


def _require_whole(
    folder: Path, record: dict, arrays: dict[str, np.ndarray], run: str | None
) -> None:
    """Raise `InputError` for files of different runs or of an older version.

    **Raises** `ValueError` for other arrays than those of the fit.
    """
    digests = {"fit.json": record.get("run", ""), "summary.npz": str(arrays.pop("run", ""))}
    if run is not None:
        digests["run.toml"] = run
    if len(set(digests.values())) > 1:
        raise InputError(
            f"{', '.join(digests)} belong to different runs; wait for another vttig that writes"
            " here, or make the fit again with --overwrite.",
            where=str(folder),
        )
    if "core" not in arrays or "arrays" not in record:
        raise InputError(
            "this fit was made by an older version; make it again with `vttig fit --run"
            f" {folder / 'run.toml'} --out {folder} --overwrite`.",
            where=str(folder),
        )
    if record["arrays"] != arrays_digest(arrays):
        raise ValueError("summary.npz holds other arrays than the fit")


def _assembled(record: dict, arrays: dict[str, np.ndarray], pair: GearPair | Drive) -> Fit:
    ends = np.cumsum(arrays["curve_lengths"])[:-1]
    pieces = [
        np.split(arrays[name], ends)
        for name in ("driving_angle", "transmission_error", "time", "residual")
    ]
    curves = tuple(
        TECurve(flank.item(), angle, error, time)
        for flank, angle, error, time in zip(arrays["curve_flanks"], *pieces[:3], strict=True)
    )
    given = record.get("flank_model")
    errors = record.get("transmission_error", {}).items()
    ratio = jnp.asarray(float(pair.ratio))
    return Fit(
        pair=pair,
        **{name: msgspec.convert(record[name], Fit.__annotations__[name]) for name in _PLAIN},
        parameters={
            name: Parameter(name=name, **own) for name, own in record["parameters"].items()
        },
        model=OrderModel(
            ratio=ratio,
            terms=tuple((int(first), int(second)) for first, second in arrays["terms"]),
            offset=jnp.asarray(arrays["offset"]),
            cosine=jnp.asarray(arrays["cosine"]),
            sine=jnp.asarray(arrays["sine"]),
        ),
        curves=curves,
        residuals=tuple(pieces[3]),
        covariance=arrays["covariance"],
        covariance_names=tuple(str(name) for name in arrays["names"]),
        values=arrays["values"],
        core=_core(arrays, float(pair.ratio)),
        stored=_stored(arrays),
        given=None
        if given is None
        else StoredModel(
            ratio, str(given), tuple((flank, FlankError(**one)) for flank, one in errors)
        ),
        regressors=tuple(Parameter(name=name, **own) for name, own in record["regressors"].items()),
    )


def _stored(arrays: dict[str, np.ndarray]) -> Measured | None:
    """Return what the run keeps of the samples; None for an older version or an own model."""
    names = [field.name for field in fields(Measured)]
    if _MEASURED + names[0] not in arrays:
        return None
    return Measured(**{name: arrays[_MEASURED + name] for name in names})


def _concatenated(pieces: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(pieces) if pieces else np.empty(0)
