"""A log of named arrays as the bytes of every binary format that is read from one file."""

import gzip
import io
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from .workbooks import xlsx

Arrays = dict[str, np.ndarray]


def _npz(arrays: Arrays) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _npy(arrays: Arrays) -> bytes:
    size = min(map(len, arrays.values()))
    record = np.zeros(size, [(name, values.dtype) for name, values in arrays.items()])
    for name, values in arrays.items():
        record[name] = values[:size]
    file = io.BytesIO()
    np.save(file, record)
    return file.getvalue()


def _mat(arrays: Arrays) -> bytes:
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, {"rec": arrays}, do_compression=len(arrays) % 2 == 0)
    return file.getvalue()


def _hdf5(arrays: Arrays) -> bytes:
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w") as written:
        for name, values in arrays.items():
            chunked = {"chunks": True, "compression": "gzip"} if len(values) > 2 else {}
            written.create_dataset(f"rec/{name}", data=values, **chunked)
    return file.getvalue()


def _arrow(suffix: str, arrays: Arrays) -> bytes:
    import pyarrow as pa
    from pyarrow import feather, parquet

    size = min(map(len, arrays.values()))
    table = pa.table({name: values[:size] for name, values in arrays.items()})
    file = io.BytesIO()
    if suffix == ".parquet":
        parquet.write_table(table, file)
    elif suffix == ".feather":
        feather.write_feather(table, file, compression="lz4")
    else:
        with pa.ipc.new_stream(file, table.schema) as writer:
            writer.write_table(table)
    return file.getvalue()


def _tdms(arrays: Arrays) -> bytes:
    import nptdms

    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        writer.write_segment([nptdms.ChannelObject("g", n, v) for n, v in arrays.items()])
    return file.getvalue()


def _mdf(arrays: Arrays) -> bytes:
    import asammdf

    size = min(map(len, arrays.values()))
    time = next(iter(arrays.values()))[:size]
    with TemporaryDirectory() as folder, asammdf.MDF(version="4.10") as file:
        signals = [
            asammdf.Signal(v[:size], time, name=name) for name, v in list(arrays.items())[1:]
        ]
        file.append(signals)
        path = Path(file.save(Path(folder) / "log.mf4", overwrite=True, compression=2))
        return path.read_bytes()


def _rows(arrays: Arrays) -> list[list[float]]:
    return np.column_stack([v[: min(map(len, arrays.values()))] for v in arrays.values()]).tolist()


def _csv_gz(arrays: Arrays) -> bytes:
    rows = [",".join(map(str, row)) for row in [[*arrays], *_rows(arrays)]]
    return gzip.compress("\n".join(rows).encode())


def _jsonl(arrays: Arrays) -> bytes:
    rows = [dict(zip(arrays, row, strict=True)) for row in _rows(arrays)]
    return "\n".join(map(json.dumps, rows)).encode()


WRITERS: dict[str, Callable[[Arrays], bytes]] = {
    ".npz": _npz,
    ".npy": _npy,
    ".mat": _mat,
    ".h5": _hdf5,
    ".parquet": partial(_arrow, ".parquet"),
    ".feather": partial(_arrow, ".feather"),
    ".arrows": partial(_arrow, ".arrows"),
    ".tdms": _tdms,
    ".mf4": _mdf,
    ".xlsx": lambda arrays: xlsx({"log": [[*arrays], *_rows(arrays)]}),
    ".csv.gz": _csv_gz,
    ".jsonl": _jsonl,
    ".json": lambda arrays: json.dumps({n: v.tolist() for n, v in arrays.items()}).encode(),
}
"""File ending → function that returns the bytes of a file."""
