"""The table of a file of any format, or of standard input.

Text layouts are tried one after the other; what none of them knows is delimited text.
"""

from collections.abc import Sequence
from pathlib import Path

from ...base.errors import LogError, UsageError
from ...base.files.limits import STDIN, keep, read_standard_input
from ...pair.schema import LogLayout
from .binary import format_of, read_binary
from .column_names import ROLES, number_of
from .delimited import find_table
from .guide_log import read_guide_log
from .layouts import read_lvm, read_sections, read_twincat, read_waveforms
from .matlab import HDF5_SIGNATURE
from .records import read_brackets, read_json, read_pairs, read_side
from .samples import read_changes, read_frames, read_halsampler, read_long
from .table import Table, one_pass, with_computed, with_joined_angles
from .text import Lines, read_text

LAYOUTS = (
    *(read_json, read_twincat, read_lvm, read_waveforms, read_frames, read_changes),
    *(read_halsampler, read_guide_log, read_long, read_side, read_pairs, read_brackets),
    read_sections,
)
"""Readers of layouts other than a table with one row for each instant, in the order of trials."""

SIGNATURES = (
    (b"MATLAB", ".mat"),
    (HDF5_SIGNATURE, ".h5"),
    (b"\x93NUMPY", ".npy"),
    (b"PK\x03\x04", ".npz"),
    (b"PAR1", ".parquet"),
    (b"FEA1", ".feather"),
    (b"ARROW1", ".arrow"),
    (b"\xff\xff\xff\xff", ".arrows"),
    (b"TDSm", ".tdms"),
    (b"MDF ", ".mf4"),
    (b"UnFinMF ", ".mf4"),
    (b"\x89MCAP0", ".mcap"),
    (b"#ROSBAG", ".bag"),
    (b"SQLite format 3", ".db3"),
)
"""First bytes and file ending of each binary format; data with other first bytes are text."""

_BY_PATH = (".mcap", ".bag", ".db3")  # their libraries open only files


def open_table(path: str | Path, layout: LogLayout = LogLayout()) -> Table:
    """Return the table of a file; its columns are parsed when they are used.

    `layout` says the form of a text, and names columns. A number such as `#4` among the names says
    that commas delimit at least four columns; other names say how a column is computed.

    **Raises** `LogError` for a file without table, `UsageError` for a format whose package is
    missing.

    **Example**
    ```python
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from vttig_jax.logs.readers.open_table import open_table
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "log.csv"
    ...     _ = path.write_text("t_s;angle [°]\\n0,0;1,5\\n0,1;2,5\\n")
    ...     table = open_table(path)
    >>> table.names, table.columns([1])[0].tolist(), table.line_of(1)
    (('t_s', 'angle [°]'), [1.5, 2.5], 3)

    ```
    """
    requested = [getattr(layout, role) for role in ROLES]
    if (binary := format_of(Path(path))) is not None:
        table = read_binary(Path(path), binary)
    else:
        lines, digest, notes = read_text(path, layout.encoding)
        table = _known_layout(lines, str(path)) if layout.delimiter is None else None
        if table is None:
            highest = max([1, *map(number_of, requested)])
            table = find_table(lines, str(path), layout, highest)
        table.digest, table.notes = digest, (*notes, *table.notes)
    return with_computed(one_pass(with_joined_angles(table), requested), requested)


def _known_layout(lines: Lines, source: str) -> Table | None:
    """Return the table of a text with one of `LAYOUTS`, or None for any other text."""
    try:
        table = next(filter(None, (read(lines) for read in LAYOUTS)), None)
    except LogError as error:  # the readers know the line, and not the name of the file
        error.where = ": ".join(filter(None, (source, error.where)))
        raise
    if table is not None:
        table.source = source
    return table


def with_standard_input(logs: Sequence[Path]) -> tuple[Path, ...]:
    """Read standard input if one of the paths `logs` is `-`, and replace this path by a name.

    Return the paths. The readers find the bytes under the new name. For a file with the name `-`
    the user gives the folder too.

    **Raises** `UsageError` if `-` is given twice or stdin is a terminal, `LogError` for a format
    that is only read from a path, and `InputError` as `read_standard_input`.
    """
    if STDIN not in logs:
        return tuple(logs)
    if list(logs).count(STDIN) > 1:
        raise UsageError("stdin (-) is given twice, but it can be read only once.")
    data = read_standard_input()
    head = data[:16]
    ending = next((end for start, end in SIGNATURES if head.startswith(start)), ".csv")
    if ending in _BY_PATH:
        raise LogError(
            "ROS files are not read from stdin; save the file, and give its path.", where=str(STDIN)
        )
    if ending == ".npz" and b".npy" not in data[:1024]:
        ending = ".xlsx"
    name = keep(data, ending)
    return tuple(name if log == STDIN else log for log in logs)
