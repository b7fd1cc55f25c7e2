"""Columns of a long text of plain numbers, read by pyarrow block by block.

pyarrow reads a line in a tenth of the time of NumPy's parser. However, the import of pyarrow takes
as long as NumPy's parser needs for 100 000 lines; therefore NumPy reads short texts. Both round
correctly, so that they return the same numbers.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .lines import Lines

LONG = 1 << 22
"""Least number of characters of a text that pyarrow reads: about 170 000 lines of time and two
counters (chosen where both parsers take the same time)."""

BLOCK = 1 << 20
"""Number of characters of a block; several copies of a block are in memory at a time (chosen)."""


_REFUSED = '#"('
"""Characters of comments, of quotes, and of `nan(1)`, which pyarrow reads as a number but NumPy
does not; a text with one of them is not read here."""


def read_in_blocks(
    lines: Lines,
    first: int,
    delimiter: str | None,
    decimal: str,
    indices: Sequence[int],
) -> list[Float[np.ndarray, " n"]] | None:
    """Return the columns `indices` of all rows from the line with index `first` on, or None.

    None means that NumPy's parser must read them: the text is short, has comments or quotes, is
    delimited by blanks, or has a row or a field that pyarrow does not read.
    """
    if lines.stop < LONG or delimiter is None or not indices:
        return None
    if any(lines.have(mark, first) for mark in _REFUSED):
        return None
    row = next((line for line in lines.starting_at(first) if line.strip()), "")
    width = row.count(delimiter) + 1
    if max(indices) >= width:
        return None
    import pyarrow as pa
    from pyarrow import csv

    names = [str(k) for k in range(width)]
    wanted = [names[k] for k in indices]
    read = csv.ReadOptions(use_threads=False, column_names=names, block_size=2 * BLOCK)
    parse = csv.ParseOptions(delimiter=delimiter, quote_char=False)
    convert = csv.ConvertOptions(
        column_types=dict.fromkeys(wanted, pa.float64()),
        include_columns=wanted,
        null_values=[],
        decimal_point=decimal,
    )
    pool = pa.system_memory_pool()  # the default pool keeps the memory of all blocks
    arrays = [np.empty(len(lines) - first) for _ in indices]
    size = 0
    for block in lines.blocks(first, BLOCK):
        if not block.strip():
            continue
        try:
            source = pa.BufferReader(block.encode())
            table = csv.read_csv(source, read, parse, convert, memory_pool=pool)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError, UnicodeEncodeError):
            return None
        for array, name in zip(arrays, wanted, strict=True):
            array[size : size + len(table)] = table.column(name).to_numpy()
        size += len(table)
    for array in arrays:
        array.resize(size, refcheck=False)
    return arrays
