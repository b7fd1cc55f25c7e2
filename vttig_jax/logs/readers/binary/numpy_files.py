"""Arrays of a NumPy file, .npy or .npz, after a check of the sizes that its headers declare."""

import io
import zipfile
from collections.abc import Iterator
from math import prod
from pathlib import Path

import numpy as np

from ....base.errors import LogError
from ....base.files.limits import MemoryBudget
from ..table import matrix_columns
from ..times.seconds import since_first


def numpy_columns(path: Path, data: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and columns; each row or column of a matrix is a separate column.

    Fields of structured arrays are columns too. The array of a .npy file has the name of the file.

    **Raises** `LogError` for arrays of objects, which are pickles, and for headers that declare
    more bytes than the file has; `InputError` beyond the memory limit; `ValueError` and others for
    damaged bytes.
    """
    budget = MemoryBudget(str(path), len(data))
    if path.suffix.lower() == ".npy":
        yield from _columns(path.stem, data, len(data), str(path))
        return
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(".npy"):
                continue
            name = member.filename.removesuffix(".npy")
            budget.take(member.file_size)
            with archive.open(member) as file:
                head = file.read(4096)
            _check_header(head, member.file_size, f"{path}: array `{name}`")
            yield from _columns(name, archive.read(member), member.file_size, str(path))


def _columns(name: str, data: bytes, size: int, source: str) -> Iterator[tuple[str, np.ndarray]]:
    _check_header(data[:4096], size, f"{source}: array `{name}`")
    array = np.load(io.BytesIO(data), allow_pickle=False)
    if array.dtype.names:
        for field in array.dtype.names:
            yield from _plain(f"{name}.{field}", array[field])
    else:
        yield from _plain(name, array)


def _plain(name: str, array: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    if array.dtype.kind == "M":
        yield f"{name} [s]", since_first(array)
    elif array.dtype.kind in "biuf":
        yield from matrix_columns(name, array)


def _check_header(head: bytes, size: int, where: str) -> None:
    """Raise `LogError` for an array of objects or a header that declares too many bytes.

    `size` is the number of bytes of the array file with its header `head`.
    """
    file = io.BytesIO(head)
    version = np.lib.format.read_magic(file)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise LogError(
            "the array holds Python objects, which only a pickle can store, and pickles are not"
            " read; save numbers.",
            where=where,
        )
    claimed = prod(shape) * dtype.itemsize
    if claimed > size - file.tell():
        raise LogError(
            f"the header claims {claimed} bytes, but {size - file.tell()} follow; the file is cut"
            " off, save it again.",
            where=where,
        )
