"""Content of the pair file for one command: read from a file, or built from options and logs."""

from pathlib import Path
from typing import TYPE_CHECKING

import tomli_w

from ..base.errors import LogError, UsageError
from ..base.files.atomic_write import os_errors_as_input_errors, replace_file
from ..logs.recognition.request import DriveRequest, ReadingOptions
from ..pair.pair_file import load_pair_spec, stated_table
from ..pair.schema import PairSpec

if TYPE_CHECKING:
    from ..logs.read import OpenLog

_HEAD = (
    "Pair file of vttig, from the options and the log. Keys that are left out have their default."
)


def stated_spec(
    logs: tuple[Path, ...], pair: Path | None, drive: DriveRequest, reading: ReadingOptions
) -> "tuple[PairSpec, tuple[OpenLog, ...]]":
    """Return the content of the pair file, and the logs if they were opened for it.

    Without `pair`, the content is built from the options in `drive` and from the columns of the
    logs. With `pair` no log is opened.

    **Raises** `UsageError` without a ratio or with two, `LogError` for a log that can be read in
    two ways, and for logs whose columns differ.
    """
    spec = spec_of_file(pair, drive)  # says that the ratio is missing
    if pair is not None:
        return spec, ()
    from ..logs.read import open_log

    opened = tuple(open_log(path, drive, reading) for path in logs)
    for one in opened:
        require_columns(one, opened[0].spec, str(logs[0]))
    return opened[0].spec, opened


def require_columns(log: "OpenLog", spec: PairSpec, first: str) -> None:
    """Raise `LogError` for a log whose columns are read unlike those of the log `first`, `spec`."""
    if log.spec != spec:
        raise LogError(
            f"its columns are read in another way than those of {first}; name them with --column,"
            " or write a pair file.",
            where=str(log.path),
        )


def spec_of_file(pair: Path | None, drive: DriveRequest) -> PairSpec:
    """Return the content of a pair file, or without it that of the options that describe the drive.

    **Raises** `UsageError` for both and for neither, `PairError` for the file.
    """
    if pair is None:
        return drive.spec()
    if drive.states_something:
        raise UsageError(
            "--pair states ratio, encoders and units already; leave out --ratio, --teeth,"
            " --counts, --unit, --invert, --driving-rpm and the scales, or leave out --pair."
        )
    return load_pair_spec(pair)


def write_pair(path: Path, spec: PairSpec) -> None:
    """Write a pair file with those keys that do not have their default.

    **Raises** `UsageError` for an existing file, `InputError` if it cannot be written.
    """
    if path.exists():
        raise UsageError("this file exists; choose another name for --write-pair.", where=str(path))
    text = f"# {_HEAD}\n{tomli_w.dumps(stated_table(spec))}"
    with os_errors_as_input_errors(path):
        replace_file(path, text.encode())
