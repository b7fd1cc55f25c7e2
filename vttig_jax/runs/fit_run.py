"""Computation of a fit from the options of a command, and its files in a run folder.

The files are `run.toml`, `fit.json`, `summary.npz` and the pictures.
"""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from ..base.errors import UsageError, VttigError
from ..base.files.json_io import dumps
from ..base.files.limits import KEPT_STEM, STDIN, kept_bytes, kept_name
from ..base.files.run_folder import RunFolder
from ..base.logger import LOGGER
from ..logs.read import read_log
from ..logs.recognition.request import DriveRequest, ReadingOptions, roles_of
from ..pair.schema import as_fraction
from .options import RunOptions
from .run_file import CHECKPOINT, RunRecord, read_run
from .stated_drive import spec_of_file, stated_spec

if TYPE_CHECKING:
    from ..identify.readings import ReadingsFit
    from ..identify.result import Fit

_FOLLOWING = (
    *("map.csv", "map.json", "report.html", CHECKPOINT, "posterior.json"),
    *(f"figures/{name}.png" for name in ("te_fit", "orders", "residual", "backlash_map")),
    *(f"figures/{name}.png" for name in ("corner", "trace", "band")),
)
"""Files of a run folder that are computed from the fit; they are removed when a new fit is written.
"""


def resolve(
    logs: tuple[Path, ...],
    pair: Path | None,
    readings: Path | None,
    options: RunOptions,
    drive: DriveRequest = DriveRequest(),
) -> RunRecord:
    """Return the record of the run that the command line requests.

    `pair` and `readings` are the paths of the pair file and of a file of backlash readings, or
    None. Without a pair file the columns of the logs are recognised with the ratio in `drive`.

    **Raises** `UsageError` if the logs, or the pair file and the ratio, are missing, and for
    options that exclude each other; `LogError` for a log that can be read in two ways.
    """
    if not logs:
        raise UsageError("LOG is missing; see `vttig fit --help`.")
    if STDIN in (pair, readings):
        raise UsageError("only a LOG may come from stdin (-); give the other files by their paths.")
    options.check(len(logs), readings=readings is not None)
    spec, opened = stated_spec(logs, pair, drive, options.reading)
    return RunRecord(logs, spec, options, readings=readings, opened=opened)


def readings_alone(
    readings: Path, pair: Path | None, drive: DriveRequest, options: RunOptions
) -> "ReadingsFit":
    """Return the fit of backlash readings without a log.

    **Raises** `UsageError` without a pair file or a ratio, `LogError` for a file without readings.
    """
    from ..identify.readings import fit_readings
    from ..logs.readers.backlash_readings import read_backlash_readings
    from ..pair.gear_pair import pair_from_spec

    spec = spec_of_file(pair, drive)
    reading = options.reading
    found = read_backlash_readings(
        readings,
        decimal=reading.decimal,
        lead_mm=reading.lead_mm or spec.log.lead_mm,
        driving=roles_of(reading.columns).get("driving"),
        driving_scale=float(as_fraction(drive.driving_scale or spec.log.driving_scale, "")),
    )
    return fit_readings(found, pair_from_spec(spec))


def perform(record: RunRecord) -> "tuple[Fit, RunRecord]":
    """Fit the logs of a record; return the fit, and the record with the SHA-256 of its files.

    **Raises** `UsageError` if two logs have the same content.
    """
    from ..base.runtime import enable_x64
    from ..identify.identification import fit
    from ..logs.readers.backlash_readings import read_backlash_readings
    from ..pair.gear_pair import pair_from_spec

    enable_x64()
    pair = pair_from_spec(record.spec)
    logs = [one.log for one in record.opened]
    reading = record.options.reading
    logs = logs or [read_log(path, pair, **reading.keywords()) for path in record.logs]
    readings = None
    if record.readings is not None:
        lead_mm = reading.lead_mm or pair.log.lead_mm
        readings = read_backlash_readings(record.readings, decimal=reading.decimal, lead_mm=lead_mm)
    result = fit(logs, pair, settings=record.options.settings, readings=readings)
    digest = "" if readings is None else readings.sha256
    return result, replace(record, sha256=tuple(log.sha256 for log in logs), readings_sha256=digest)


def record_of(fit: "Fit") -> RunRecord:
    """Return the run record (logs, pair file and options) of a fit that was computed in Python.

    **Raises** `UsageError` for a fit from `read_fit`, which has no settings.
    """
    from ..pair.gear_pair import spec_of

    if fit.request is None:
        raise UsageError(
            "this fit was read from a folder; take it from `vttig_jax.open_run(folder).fit`,"
            " which knows its options, or copy the folder.",
            where=fit.source,
        )
    options = RunOptions(ReadingOptions.of(**fit.request.reading), fit.request.settings)
    record = RunRecord(
        tuple(
            path or Path(log.source) for path, log in zip(fit.request.paths, fit.logs, strict=True)
        ),
        msgspec.structs.replace(spec_of(fit.pair), fit=fit.request.orders),
        options,
        tuple(log.sha256 for log in fit.logs),
        flank_model="" if fit.given is None else fit.given.name,
    )
    if (readings := fit.checks.readings) is None:
        return record
    return replace(record, readings=Path(readings.source), readings_sha256=readings.sha256)


def save_fit(
    fit: "Fit",
    folder: str | Path,
    *,
    overwrite: bool = False,
    figures: bool = True,
    record: RunRecord | None = None,
) -> None:
    """Write a run folder: `run.toml`, `fit.json`, `summary.npz` and the pictures.

    The folder does not change until all files are written. Posterior draws of an older fit in the
    folder are removed.

    **Arguments**
    - `fit`: result of `vttig_jax.fit`, or the fit of an open run.
    - `folder`: run folder; it is created if it does not exist.
    - `overwrite`: replace the fit that is in the folder.
    - `figures`: draw the pictures too.
    - `record`: logs and options of the fit; by default those stored in `fit`.

    **Raises** `UsageError` for an existing fit without `overwrite`, for a fit without settings, and
    if another process writes to the folder; `InputError` for a full disk, missing permission and a
    path that is not a folder.
    """
    record, folder = record or record_of(fit), Path(folder)
    lock = folder / f".{CHECKPOINT}.lock"
    if lock.exists():
        from filelock import FileLock, Timeout

        try:
            with FileLock(lock).acquire(timeout=0):
                pass
        except Timeout:
            raise UsageError(
                "a sampler is writing to this folder; wait for it or choose another folder.",
                where=str(folder),
            ) from None
    with RunFolder(folder, overwrite=overwrite, results=("fit.json",)) as writer:
        if (folder / CHECKPOINT).exists():
            LOGGER.warning("the draws in %s were those of the fit it replaces, and go", folder)
        write_fit(writer, fit, record, figures=figures)


def write_fit(writer: RunFolder, fit: "Fit", record: RunRecord, *, figures: bool = True) -> None:
    """Write a fit into an open run folder, and remove the files that depend on an older fit.

    Logs that came from standard input are stored in the folder.
    """
    from ..identify.archive import arrays_digest, fit_arrays
    from ..identify.backlash import backlash_map
    from ..plotting.save import figures as pictures

    for name in (*_FOLLOWING, *_unused_kept_logs(writer.path, record)):
        writer.discard(name)
    for log in record.logs:
        if (data := kept_bytes(log)) is not None:
            writer.write_bytes(kept_name(log), data)
    table, arrays, content = record.table(writer.path), fit_arrays(fit), fit.to_json()
    held = arrays_digest(arrays)
    # The paths of the logs are left out, so that the same run elsewhere has the same digest.
    data = {name: table["data"].get(name) for name in ("sha256", "readings_sha256")}
    identified = dumps([table | {"data": data}, content, held])
    digest = hashlib.sha256(identified.encode()).hexdigest()
    writer.write_toml("run.toml", {"schema": table["schema"], "run": digest} | table)
    writer.write_npz("summary.npz", **arrays, run=np.array(digest))
    if figures:
        known = fit.parameters["constant_backlash_deg"].determined
        drawn = pictures(fit, backlash_map(fit) if known else None, run=digest)
        for name, picture in drawn.items():
            writer.write_bytes(f"figures/{name}", picture)
    content = {"schema": content["schema"], "run": digest, "arrays": held} | content
    writer.write_text("fit.json", dumps(content) + "\n")


def _unused_kept_logs(folder: Path, record: RunRecord) -> list[str]:
    """Return the names of files that the new run `record` in `folder` does not need.

    They are logs from standard input that were stored in the folder for its old run.
    """
    try:
        old = read_run(folder)
    except VttigError:  # there is no old run, or it is damaged
        return []
    used = {log.resolve() for log in record.logs}
    kept = [log for log in old.logs if log.name.startswith(f"{KEPT_STEM}.")]
    return [
        log.name
        for log in kept
        if log.resolve().parent == folder.resolve() and log.resolve() not in used
    ]
