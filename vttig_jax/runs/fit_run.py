"""Computation of a fit from the options of a command, and the files of a fit in a run folder.

The files are `run.toml`, `fit.json`, `summary.npz` and the pictures; of the posterior of a fit they
are the draws, their report `posterior.json`, the map with its bands and the pictures.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import tomli_w

from ..base.errors import NoAnswerError, UsageError, VttigError
from ..base.files.atomic_write import settle_if_free
from ..base.files.json_io import dumps, read_json
from ..base.files.limits import KEPT_STEM, STDIN, kept_bytes, kept_name
from ..base.files.run_folder import RunFolder
from ..base.logger import LOGGER
from ..logs.read import read_log
from ..logs.recognition.request import DriveRequest, ReadingOptions, roles_of
from ..pair.schema import as_fraction
from .map_table import banded_table, csv_text
from .run_file import CHECKPOINT, DRAWN, REPORT, RunOptions, RunRecord, read_run
from .stated_drive import spec_of_file, stated_spec

if TYPE_CHECKING:
    from ..identify.readings import ReadingsFit
    from ..identify.result import Fit
    from ..posterior.summary.bands import BandedMap
    from ..posterior.summary.posterior import Posterior

_FOLLOWING = (
    *("map.csv", "map.json", "report.html", CHECKPOINT, REPORT, *DRAWN),
    *(f"figures/{name}.png" for name in ("te_fit", "orders", "residual", "backlash_map")),
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
    beside: Mapping[str, str] = {},
) -> None:
    """Write a run folder: `run.toml`, `fit.json`, `summary.npz` and the pictures.

    The folder does not change until all files are written. Files that depend on an older fit, such
    as its draws, are removed. Logs that came from standard input are stored in the folder.

    **Arguments**
    - `fit`: result of `vttig_jax.fit`, or the fit of an open run.
    - `folder`: run folder; it is created if it does not exist.
    - `overwrite`: replace the fit that is in the folder.
    - `figures`: draw the pictures too.
    - `record`: logs and options of the fit; by default those stored in `fit`.
    - `beside`: name → content of further text files.

    **Raises** `UsageError` for an existing fit without `overwrite`, for a fit without settings, and
    if another process writes to the folder; `InputError` for a full disk, missing permission and a
    path that is not a folder.
    """
    from ..identify.archive import arrays_digest, fit_arrays
    from ..identify.backlash import backlash_map
    from ..plotting.save import figures as pictures

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
        for name in (*_FOLLOWING, *_unused_kept_logs(folder, record)):
            writer.discard(name)
        for log in record.logs:
            if (data := kept_bytes(log)) is not None:
                writer.write_bytes(kept_name(log), data)
        for name, text in beside.items():
            writer.write_text(name, text)
        table, arrays, content = record.table(folder), fit_arrays(fit), fit.to_json()
        held = arrays_digest(arrays)
        # The paths of the logs are left out, so that the same run elsewhere has the same digest.
        data = {name: table["data"].get(name) for name in ("sha256", "readings_sha256")}
        identified = dumps([table | {"data": data}, content, held])
        digest = hashlib.sha256(identified.encode()).hexdigest()
        stated = {"schema": table["schema"], "run": digest} | table
        writer.write_text("run.toml", tomli_w.dumps(stated))
        buffer = BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays, run=np.array(digest))
        writer.write_bytes("summary.npz", buffer.getvalue())
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


def banded_of(posterior: "Posterior") -> "BandedMap | None":
    """Return the backlash map of a posterior with its bands; None if its logs tell no gap."""
    from ..posterior.summary.bands import band_map

    try:
        return band_map(posterior)
    except NoAnswerError:
        return None


def save_posterior(
    posterior: "Posterior",
    folder: str | Path,
    *,
    overwrite: bool = False,
    figures: bool = True,
) -> None:
    """Write the draws, their report, the map with its bands and the pictures into a run folder.

    The fit of the posterior is written first if the folder does not contain it. `vttig sample
    --resume` can continue the draws. Draws that `sample(…, checkpoint=…, resume=True)` continued
    in this folder need no `overwrite`: their report replaces that of the shorter chains.

    **Arguments**
    - `posterior`: result of `vttig_jax.sample`, or the posterior of an open run.
    - `folder`: run folder; it is created if it does not exist.
    - `overwrite`: replace the fit and the draws that are in the folder.
    - `figures`: draw the pictures too.

    **Raises** `UsageError` for existing draws or another fit without `overwrite`, and if another
    process writes to the folder; `InputError` for a full disk, missing permission and a path that
    is not a folder.
    """
    folder = Path(folder)
    settle_if_free(folder)
    if not _holds(folder, posterior):
        if (folder / "fit.json").exists() and not overwrite:
            raise UsageError(
                "this folder holds another fit than that of the draws; choose another folder, or"
                " replace it with overwrite=True.",
                where=str(folder),
            )
        save_fit(posterior.fit, folder, overwrite=overwrite, figures=figures)
    place = folder / CHECKPOINT
    longer = not overwrite and not _is_reported(folder, posterior)
    longer = longer and place.exists() and posterior.chains.continues(place)
    posterior.chains.save(place, overwrite=overwrite or longer)
    write_report(folder, posterior, figures=figures)


def _holds(folder: Path, posterior: "Posterior") -> bool:
    """Return whether `fit.json` in a folder equals the fit from which the posterior was drawn."""
    stored, drawn = read_json(folder / "fit.json"), json.loads(dumps(posterior.fit.to_json()))
    if isinstance(stored, dict):
        for digest in ("run", "arrays"):
            stored.pop(digest, None)
    return stored == drawn


def _is_reported(folder: Path, posterior: "Posterior") -> bool:
    """Return whether the report in a folder states as many steps as the chains of `posterior`."""
    try:
        return read_json(folder / REPORT)["diagnosis"]["steps"] == posterior.diagnosis.steps
    except (KeyError, TypeError):
        return False


def write_report(
    folder: Path, posterior: "Posterior", *, figures: bool = True
) -> "BandedMap | None":
    """Write `posterior.json`, the map with its bands, and the pictures; return the map.

    If the folder has a report on chains with another number of steps, its pictures are removed,
    even without `figures`.
    """
    from ..plotting.save import figures as pictures

    banded = banded_of(posterior)
    outdated = () if _is_reported(folder, posterior) else (*DRAWN, "report.html")
    run = (read_json(folder / "fit.json") or {}).get("run", "")
    with RunFolder(folder, overwrite=True, results=(REPORT,)) as writer:
        for name in outdated:
            writer.discard(name)
        if figures:
            for name, data in pictures(posterior, banded, run=run).items():
                writer.write_bytes(f"figures/{name}", data)
        if banded is not None:
            found = banded_table(banded, posterior.fit, Path("map.csv"))
            writer.write_text("map.csv", csv_text(found.columns))
            writer.write_text("map.json", dumps(found.record | {"run": run}) + "\n")
        writer.write_text(REPORT, dumps(posterior.to_json() | {"run": run}) + "\n")
    return banded
