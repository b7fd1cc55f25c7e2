"""Files of a fit: `fit.json` for people, `summary.npz` for the next command; no pickles."""

import hashlib
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import msgspec
import numpy as np

from ..base.errors import InputError, UsageError
from ..base.files.commit import settle_if_free
from ..base.files.limits import MemoryBudget, read_regular
from ..kinematics.flank_error import FlankError
from ..kinematics.harmonic import OrderModel
from ..kinematics.te_curve import TECurve
from ..pair.gear_pair import Drive, GearPair
from .evidence import evidence_from
from .fit_result import Fit
from .model.fitted_model import StoredModel
from .noise.noise_model import NoiseModel
from .report.checks import Checks
from .report.order_table import Order
from .report.parameters import Parameter
from .report.per_log import LogRecord
from .settings import NoiseSettings

_EVIDENCE = "evidence_"


def fit_arrays(fit: Fit) -> dict[str, np.ndarray]:
    """Return the arrays that store a fit, by name.

    They hold its harmonics, parameters with covariance, noise, curves and residuals. If the fit
    keeps its compressed logs (`Fit.evidence`), their names begin with "evidence_".
    """
    curves = fit.curves
    evidence = {} if fit.evidence is None else fit.evidence.to_arrays()
    return {
        **{_EVIDENCE + name: array for name, array in evidence.items()},
        "terms": np.asarray(fit.model.terms, np.int64).reshape(-1, 2),
        "offset": np.asarray(fit.model.offset),
        "cosine": np.asarray(fit.model.cosine),
        "sine": np.asarray(fit.model.sine),
        "names": np.asarray(fit.covariance_names),
        "values": fit.values,
        "covariance": fit.covariance,
        **_noise_arrays(fit.noise),
        "curve_flanks": np.asarray([curve.flank for curve in curves]),
        "curve_lengths": np.asarray([len(curve) for curve in curves], np.int64),
        "driving_angle": _joined([curve.driving_angle for curve in curves]),
        "transmission_error": _joined([curve.transmission_error for curve in curves]),
        "time": _joined([curve.time for curve in curves]),
        "residual": _joined(list(fit.residuals)),
    }


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
    its files belong to different runs.
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
        _require_one_run(folder, record, arrays, run)
        _require_unchanged(record, arrays)
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


def _require_one_run(
    folder: Path, record: dict, arrays: dict[str, np.ndarray], run: str | None
) -> None:
    """Raise `InputError` for files of different runs; files of older versions carry no digest."""
    digests = {"fit.json": record.get("run", ""), "summary.npz": str(arrays.pop("run", ""))}
    if run is not None:
        digests["run.toml"] = run
    if len(set(digests.values())) > 1:
        raise InputError(
            f"{', '.join(digests)} belong to different runs; wait for another vttig that writes"
            " here, or make the fit again with --overwrite.",
            where=str(folder),
        )


def _require_unchanged(record: dict, arrays: dict[str, np.ndarray]) -> None:
    """Raise `ValueError` for other arrays than those of the fit, or for shapes that do not fit.

    Files of older versions carry no digest of their arrays.
    """
    if record.get("arrays") not in (None, arrays_digest(arrays)):
        raise ValueError("summary.npz holds other arrays than the fit")
    terms, names = len(arrays["terms"]), len(arrays["names"])
    samples = int(arrays["curve_lengths"].sum())
    shapes = {
        "terms": (terms, 2),
        "offset": (2,),
        "cosine": (2, terms),
        "sine": (2, terms),
        "values": (names,),
        "covariance": (names, names),
        **dict.fromkeys(("driving_angle", "transmission_error", "time", "residual"), (samples,)),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(f"`{name}` has the shape {arrays[name].shape} and not {shape}")


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
    kept = {
        name.removeprefix(_EVIDENCE): array
        for name, array in arrays.items()
        if name.startswith(_EVIDENCE)
    }
    orders = OrderModel(
        ratio=jnp.asarray(float(pair.ratio)),
        terms=tuple((int(first), int(second)) for first, second in arrays["terms"]),
        offset=jnp.asarray(arrays["offset"]),
        cosine=jnp.asarray(arrays["cosine"]),
        sine=jnp.asarray(arrays["sine"]),
    )
    given = record.get("flank_model")
    errors = record.get("transmission_error", {}).items()
    return Fit(
        pair=pair,
        source=record["source"],
        sha256=record["sha256"],
        outcome=record["outcome"],
        flanks=tuple(record["flanks"]),
        samples=record["samples"],
        zero=record["zero"],
        zero_readings=record["zero_readings"],
        conditional_on=tuple(record["conditional_on"]),
        parameters={
            name: Parameter(name=name, **fields) for name, fields in record["parameters"].items()
        },
        orders=tuple(Order(**fields) for fields in record["orders"]),
        model=orders,
        given=None
        if given is None
        else StoredModel(
            orders.ratio, str(given), tuple((flank, FlankError(**one)) for flank, one in errors)
        ),
        noise=_noise_from(arrays),
        residual_rms_deg=record["residual_rms_deg"],
        curves=curves,
        residuals=tuple(pieces[3]),
        covariance=arrays["covariance"],
        covariance_names=tuple(str(name) for name in arrays["names"]),
        values=arrays["values"],
        checks=msgspec.convert(record["checks"], Checks),
        notes=tuple(record["notes"]),
        warnings=tuple(record.get("warnings", ())),
        regressors=tuple(
            Parameter(name=name, **fields) for name, fields in record["regressors"].items()
        ),
        logs=msgspec.convert(record["logs"], tuple[LogRecord, ...]),
        evidence=evidence_from(kept, pair.ratio) if kept else None,
    )


def _noise_arrays(noise: NoiseModel) -> dict[str, np.ndarray]:
    """Return the noise as arrays: a row for all speeds together, then a row for every plateau."""
    models, choice = [noise, *(own for _, own in noise.plateaus)], noise.choice
    coefficients = np.full((len(models), max(len(m.coefficients) for m in models)), np.nan)
    for row, model in zip(coefficients, models, strict=True):
        row[: len(model.coefficients)] = model.coefficients
    return {
        "noise_coefficients": coefficients,
        "noise": np.array([(m.innovation_std, m.std, m.block_s) for m in models]),
        "noise_by": np.array([m.by for m in models]),
        "noise_choice": np.array([choice.kind, choice.stationary_in, choice.of]),
        "noise_speeds": np.array([speed for speed, _ in noise.plateaus], float),
    }


def _noise_from(arrays: dict[str, np.ndarray]) -> NoiseModel:
    choice = NoiseSettings(*(str(word) for word in arrays["noise_choice"]))  # pyright: ignore
    models = [
        NoiseModel(
            coefficients=row[np.isfinite(row)],
            innovation_std=float(shock),
            std=float(std),
            block_s=float(block_s),
            plateaus=(),
            choice=choice,
            by=str(by),
        )
        for row, (shock, std, block_s), by in zip(
            arrays["noise_coefficients"], arrays["noise"], arrays["noise_by"], strict=True
        )
    ]
    speeds = (float(speed) for speed in arrays["noise_speeds"])
    return replace(models[0], plateaus=tuple(zip(speeds, models[1:], strict=True)))


def _joined(pieces: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(pieces) if pieces else np.empty(0)
