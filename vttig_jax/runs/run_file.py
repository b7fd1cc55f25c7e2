"""`run.toml`: logs, pair file and options of a run folder, from which the run can be repeated."""

import os
import tomllib
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from ..base.errors import InputError, UsageError
from ..base.files.atomic_write import settle_if_free
from ..base.files.limits import kept_bytes, kept_name, read_regular
from ..base.files.run_folder import data_sha256
from ..base.shown_text import shown_name
from ..identify.fit_settings import FitSettings
from ..logs.readers.binary import format_of
from ..logs.recognition.request import ReadingOptions, roles_of
from ..pair.pair_file import parse_pair_spec, spec_table
from ..pair.schema import PairSpec

if TYPE_CHECKING:
    from ..logs.read import OpenLog
    from ..logs.recognition.candidates import Guess

CHECKPOINT, REPORT, SWEEP = "posterior.h5", "posterior.json", "sweep.parquet"
FIT_FILES = ("run.toml", "fit.json", "summary.npz")
DRAWN = tuple(f"figures/{name}.png" for name in ("corner", "trace", "band"))
"""Files of a run folder: draws, their report, sweep, those of a fit, pictures of draws."""

SCHEMA = "vttig.run/1"
_PACKAGES = ("vttig-jax", "jax", "jaxlib", "equinox", "optimistix", "numpy", "scipy")


class RunOptions(msgspec.Struct, frozen=True):
    """Options of a fit in `run.toml`: how its logs are read, and the settings of the fit."""

    reading: ReadingOptions = ReadingOptions()
    settings: FitSettings = FitSettings()

    def check(self, logs: int, *, readings: bool) -> None:
        """Raise `UsageError` for options that exclude each other or do not apply.

        `logs` is the number of logs; `readings` is true if backlash readings are given.
        """
        roles_of(self.reading.columns)
        settings = self.settings
        if settings.use_readings and not readings:
            raise UsageError("--use-readings needs --backlash-readings FILE.")
        if settings.same_zero is not None and logs == 1:
            name = "--same-zero" if settings.same_zero else "--own-zero"
            raise UsageError(f"{name} compares several logs, but there is one; leave it out.")

    def table(self) -> dict[str, Any]:
        """Return the table `[options]` of `run.toml`, without the options that have no value."""
        merged = msgspec.to_builtins(self.reading) | msgspec.to_builtins(self.settings)
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in merged.items()
            if value is not None
        }


def options_from(table: dict[str, Any]) -> RunOptions:
    """Return the options in the table `[options]` of `run.toml`; missing options have defaults.

    **Raises** `msgspec.ValidationError` or `TypeError` for a damaged table.
    """
    if not isinstance(table, dict):
        raise TypeError("options")
    names = ReadingOptions.__struct_encode_fields__
    reading = {name: value for name, value in table.items() if name in names}
    settings = {name: value for name, value in table.items() if name not in names}
    return RunOptions(
        msgspec.convert(reading, ReadingOptions), msgspec.convert(settings, FitSettings)
    )


@dataclass(frozen=True)
class RunRecord:
    """One call of `vttig fit` with all its inputs.

    **Arguments**
    - `logs`: log files. - `spec`: content of their pair file.
    - `options`: options of the fit.
    - `sha256`: SHA-256 of every log; empty before they are read.
    - `readings`, `readings_sha256`: file of backlash readings, and its SHA-256.
    - `opened`: the logs, if they were opened to build `spec` without a pair file; not stored.
    - `flank_model`: class name of the flank model that a user gave in Python; "" without one.
    - `versions`: name of a package → its version at the time of a stored run.
    - `digest`: SHA-256 that identifies a stored run and is in all files of its fit; "" for a new
      run and for folders of older versions.
    """

    logs: tuple[Path, ...]
    spec: PairSpec
    options: RunOptions = field(default_factory=RunOptions)
    sha256: tuple[str, ...] = ()
    readings: Path | None = None
    readings_sha256: str = ""
    opened: "tuple[OpenLog, ...]" = field(default=(), repr=False, compare=False)
    flank_model: str = ""
    digest: str = ""
    versions: dict[str, str] = field(default_factory=dict, compare=False)

    @property
    def guesses(self) -> "tuple[Guess, ...]":
        """What was recognised in the first log to build `spec` without a pair file."""
        return self.opened[0].roles.guesses if self.opened else ()

    def table(self, folder: Path) -> dict[str, Any]:
        """Return the content of `run.toml` with paths relative to the run folder `folder`."""
        base = folder.resolve()
        data: dict[str, Any] = {
            "logs": [
                str(log) if digest == "" else _relative(log, base)
                for log, digest in zip_longest(self.logs, self.sha256)
            ],
            "sha256": list(self.sha256),
        }
        if self.readings is not None:
            data["readings"] = _relative(self.readings, base)
            data["readings_sha256"] = self.readings_sha256
        if self.flank_model:
            data["flank_model"] = self.flank_model
        return {
            "schema": SCHEMA,
            "versions": {name: version(name) for name in _PACKAGES},
            "data": data,
            "options": self.options.table(),
            "pair_file": spec_table(self.spec),
        }


def read_run(path: Path) -> RunRecord:
    """Read a `run.toml`, given its path or that of its folder.

    **Raises** `UsageError` if the file is missing, and `InputError` if its format is different.
    """
    path = path / "run.toml" if path.is_dir() else path
    settle_if_free(path.parent)
    try:
        table = tomllib.loads(read_regular(path).decode("utf-8"))
    except FileNotFoundError:
        raise UsageError(
            "no such run; make one with `vttig fit LOG --ratio 64:23 --out DIR`, or with --pair.",
            where=str(path),
        ) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}.", where=str(path)) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        if path.suffix != ".toml":
            raise InputError(
                "this is no run folder; if it is a log, fit it first with"
                f" `vttig fit {path.name} --ratio 64:23 --out run`, and give that folder.",
                where=str(path),
            ) from None
        raise InputError(f"not a run file: {error}.", where=str(path)) from None
    if table.get("schema") != SCHEMA:
        raise InputError(
            f"its schema is {table.get('schema')!r}, but this version reads {SCHEMA!r}.",
            where=str(path),
        )
    try:
        logs, digests = _data(table["data"])
        spec = parse_pair_spec(table["pair_file"], f"{path}: pair_file")
        options = options_from(table["options"])
        readings = table["data"].get("readings")
        options.check(len(logs), readings=readings is not None)
    except (KeyError, TypeError) as error:
        raise InputError(f"the entry {error} is missing or damaged.", where=str(path)) from None
    except (msgspec.ValidationError, ValueError) as error:
        raise InputError(f"its options are damaged: {error}.", where=str(path)) from None
    except UsageError as error:
        raise InputError(f"its options are damaged: {error.message}", where=str(path)) from None
    return RunRecord(
        tuple(_place(log, path) for log in logs),
        spec,
        options,
        digests,
        readings=None if readings is None else _place(str(readings), path),
        readings_sha256=str(table["data"].get("readings_sha256", "")),
        flank_model=str(table["data"].get("flank_model", "")),
        digest=str(table.get("run", "")),
        versions={str(k): str(v) for k, v in dict(table.get("versions", {})).items()},
    )


def require_same_data(run: RunRecord) -> None:
    """Raise `InputError` if a run cannot be repeated from its files.

    That is so if a log or the file of readings is missing, has changed or never was a file, and if
    the flank model is a Python class of the user.
    """
    if run.flank_model:
        raise InputError(
            f"this run has the flank model {run.flank_model}, whose code run.toml does not hold;"
            " repeat the fit in Python with `vttig_jax.fit(…, model=…)`.",
            where=", ".join(map(str, run.logs)),
        )
    files = [("log", log, digest) for log, digest in zip(run.logs, run.sha256, strict=True)]
    if run.readings is not None:
        files.append(("file of readings", run.readings, run.readings_sha256))
    for kind, path, digest in files:
        if not digest:
            raise InputError(
                f"the {kind} of this run was fitted from arrays in Python; there is no file to"
                " repeat it from.",
                where=str(path),
            )
        if not path.is_file() and format_of(path) is None:
            raise InputError(f"the {kind} of this run is no longer there.", where=str(path))
        if digest != data_sha256(path):
            raise InputError(
                f"this {kind} has changed since the run (its SHA-256 differs); fit it anew with"
                " --pair.",
                where=str(path),
            )


def _relative(path: Path, base: Path) -> str:
    if kept_bytes(path) is not None:  # standard input, which is kept in the run folder
        return kept_name(path)
    name = Path(os.path.relpath(path.resolve(), base)).as_posix()
    try:
        name.encode()
    except UnicodeEncodeError:
        raise UsageError(
            "the name of this file is no UTF-8 text, so that run.toml cannot hold it; rename it.",
            where=str(path),
        ) from None
    return name


def _place(name: str, run_file: Path) -> Path:
    """Return the resolved path of a file, relative to the working folder if it is inside of it.

    `name` is relative to the folder of `run_file`.
    **Raises** `InputError` for a name that no file can have, such as one with a null character.
    """
    try:
        whole, here = (run_file.parent / name).resolve(), Path.cwd()
    except (OSError, ValueError) as error:
        raise InputError(
            f"{shown_name(name)} in its `data` is no path of a file ({error}).", where=str(run_file)
        ) from None
    return whole.relative_to(here) if whole.is_relative_to(here) else whole


def _data(table: dict[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names and digests of the logs.

    **Raises** `KeyError` or `TypeError` with the name of the missing or damaged entry.
    """
    for name in ("logs", "sha256"):
        texts = table[name]
        if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
            raise TypeError(f"data.{name}")
    if not table["logs"] or len(table["logs"]) != len(table["sha256"]):
        raise TypeError("data.sha256")
    return tuple(table["logs"]), tuple(table["sha256"])
