"""Columns of a Parquet, Feather or Arrow file; an Arrow file may also be a stream."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....base.files.limits import MemoryBudget
from ..times.seconds import since_first
from .declared_sizes import take_arrow

PARQUET = (".parquet", ".pq")
_WIDEST = 8  # bytes of a number
_MAGIC = 8  # bytes of the signature at the start of an Arrow file, with padding
UNIT_KEYS = (b"unit", b"units", b"unit_string")
"""Keys under which the metadata of a field may contain its unit."""


def arrow_columns(path: Path, data: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and columns of numbers and of time stamps; stamps are in s since the first one.

    A unit in the metadata of a field is appended to its name in brackets. Damaged bytes raise
    various exceptions of pyarrow; numbers beyond the memory limit raise `InputError`.
    """
    import pyarrow as pa

    table = _table(pa, path, data)
    for field, column in zip(table.schema, table.columns, strict=True):
        unit = next((v for k, v in (field.metadata or {}).items() if k.lower() in UNIT_KEYS), b"")
        name = f"{field.name} [{unit.decode('utf-8', 'replace')}]" if unit else field.name
        kinds = pa.types.is_timestamp, pa.types.is_time, pa.types.is_duration
        if any(is_kind(field.type) for is_kind in kinds):
            yield f"{field.name} [s]", _seconds(pa, column)
        elif pa.types.is_integer(field.type) or pa.types.is_floating(field.type):
            yield name, np.asarray(column.to_numpy())
        elif pa.types.is_decimal(field.type):
            yield name, np.asarray(column.cast(pa.float64()).to_numpy())


def _table(pa: Any, path: Path, data: bytes) -> Any:
    """Return the pyarrow table of a Parquet, Feather or Arrow file."""
    budget = MemoryBudget(str(path), len(data))
    if path.suffix.lower() in PARQUET:
        from pyarrow import parquet

        file = parquet.ParquetFile(io.BytesIO(data))
        meta = file.metadata
        unpacked = sum(meta.row_group(k).total_byte_size for k in range(meta.num_row_groups))
        budget.take(max(_WIDEST * meta.num_rows * meta.num_columns, unpacked))
        return file.read()
    if data[:4] == b"FEA1":
        from pyarrow import feather

        return feather.read_table(io.BytesIO(data))
    # An Arrow file is a stream between signature and footer; the counted messages are those read.
    messages = data[_MAGIC:] if data[:6] == b"ARROW1" else data
    take_arrow(pa.ipc.MessageReader.open_stream(pa.BufferReader(messages)), budget)
    with pa.ipc.open_stream(pa.BufferReader(messages)) as stream:
        return stream.read_all()


def _seconds(pa: Any, column: Any) -> np.ndarray:
    """Return stamps in s since the first stamp; a missing stamp is NaN."""
    whole = column.cast(pa.int32() if column.type.bit_width == 32 else pa.int64())
    stamps = whole.fill_null(0).to_numpy().astype(f"timedelta64[{column.type.unit}]")
    missing = whole.is_null().to_numpy(zero_copy_only=False)
    return since_first(np.where(missing, np.timedelta64("NaT"), stamps))
