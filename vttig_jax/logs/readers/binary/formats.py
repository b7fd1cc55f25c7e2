"""Binary formats: the reader of each, and the optional dependency that the reader needs."""

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ....base.errors import InputError, LogError, UsageError
from ..table import Table
from ..text import read_bytes
from .clocked import ClockedColumn, table_of


@dataclass(frozen=True)
class Format:
    """Binary format.

    **Arguments**
    - `name`: name of the format in messages. - `endings`: its file endings.
    - `reader`: "module:function" that yields columns from the path and the bytes of a file.
    - `needs`: import name of the library; `extra`: extra of vttig-jax that installs it.
    - `note`: note on the time of its channels, "" without a note.
    """

    name: str
    endings: tuple[str, ...]
    reader: str
    needs: str
    extra: str = ""
    note: str = ""


_ARROW = (".parquet", ".pq", ".feather", ".arrow", ".arrows", ".ipc")
_TDMS = "TDMS: the time of a waveform is its increment times the number of the sample"
_MDF = "MDF: every group of channels has its own time stamps"
_ROS = "ROS: stamps are those in the headers of the messages, else those of the recording"
FORMATS = (
    Format("NumPy", (".npy", ".npz"), "numpy_files:numpy_columns", "numpy"),
    Format("Arrow", _ARROW, "arrow_files:arrow_columns", "pyarrow"),
    Format("TDMS", (".tdms",), "tdms:tdms_columns", "nptdms", "tdms", _TDMS),
    Format("MDF", (".mf4", ".mdf", ".mf3"), "mdf:mdf_columns", "asammdf", "mdf", _MDF),
    Format("ROS", (".mcap", ".bag", ".db3"), "rosbag:rosbag_columns", "rosbags", "ros", _ROS),
)
"""Binary formats other than MATLAB and HDF5."""

BAG = "metadata.yaml"
"""File in the folder of a ROS 2 bag."""


def format_of(path: Path) -> Format | None:
    """Return the binary format of a file or of the folder of a ROS 2 bag, or None."""
    if path.is_dir():
        return FORMATS[-1] if (path / BAG).is_file() else None
    ending = path.suffix.lower()
    return next((one for one in FORMATS if ending in one.endings), None)


def read_binary(path: Path, form: Format) -> tuple[Table, str, tuple[str, ...]]:
    """Return the columns of a file, the SHA-256 of its bytes, and notes.

    **Raises** `UsageError` without the library of the format; `LogError` for a missing, damaged or
    unreadable file or one without numbers.
    """
    source = str(path)
    data = b"" if path.is_dir() else read_bytes(path, form.endings)
    digest = folder_sha256(path) if path.is_dir() else hashlib.sha256(data).hexdigest()
    reader = _reader(form)
    try:
        table = _table(reader(path, data), source)
    except (InputError, UsageError, MemoryError):
        raise
    except Exception:  # damaged bytes raise various exceptions
        raise LogError(
            f"the file is damaged or no {form.name} file; save it again, or export the log as CSV.",
            where=source,
        ) from None
    if not table.names:
        raise LogError(
            f"the {form.name} file has no channel of numbers; export the log again.", where=source
        )
    return table, digest, (form.note,) if form.note and table.clocks else ()


def folder_sha256(path: Path) -> str:
    """Return one common SHA-256 of the names and bytes of all files in a folder."""
    digest = hashlib.sha256()
    for file in sorted(one for one in path.rglob("*") if one.is_file()):
        digest.update(f"{file.relative_to(path).as_posix()}\0".encode())
        with open(file, "rb") as opened:
            digest.update(hashlib.file_digest(opened, "sha256").digest())
    return digest.hexdigest()


def _reader(form: Format) -> Callable[[Path, bytes], Iterable[Any]]:
    module, _, function = form.reader.partition(":")
    try:
        import_module(form.needs)
    except ImportError:
        raise UsageError(
            f"{form.name} files need the package {form.needs}; install it with"
            f' `pip install "vttig-jax[{form.extra}]"`.'
        ) from None
    return getattr(import_module(f".{module}", __package__), function)


def _table(columns: Iterable[tuple[str, np.ndarray] | ClockedColumn], source: str) -> Table:
    """Return the table of named arrays or of channels with separate time stamps."""
    return table_of(
        (one if isinstance(one, ClockedColumn) else ClockedColumn(*one) for one in columns), source
    )
