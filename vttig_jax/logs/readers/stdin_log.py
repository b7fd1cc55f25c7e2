"""Log from standard input: its path is `-`, and its first bytes define the file format."""

from collections.abc import Sequence
from pathlib import Path

from ...base.errors import LogError, UsageError
from ...base.files.standard_input import STDIN, keep, read_standard_input
from .binary.hdf5 import HDF5_SIGNATURE

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
