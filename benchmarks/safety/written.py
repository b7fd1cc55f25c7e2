"""Written files, read back by other programs: which of them does a reader of the format reject."""

import csv
import json
import os
import re
import subprocess
import tempfile
import tomllib
from collections.abc import Callable
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from .calls import hidden

_FORMULA = re.compile(r"[=+\-@\t\r]")
_TEXT = (".csv", ".h", ".obj", ".svg", ".dxf", ".txt")


def rejected(folder: Path, known: set[Path]) -> list[str]:
    """Return the faults of all new files below a folder, as `suffix: what is wrong`."""
    found = []
    for path in sorted(folder.rglob("*")):
        if path in known or not path.is_file() or path.is_symlink():
            continue
        if path.name.endswith(".tmp") or path.name in (".lock", ".commit.json"):
            found.append(f"{path.name} is left")
        reader = READERS.get(path.suffix)
        if reader is None:
            continue
        data = path.read_bytes()
        try:
            reader(data)
        except Exception as error:  # every reader has its own
            found.append(f"{path.suffix}: {type(error).__name__} {str(error)[:80]!r}")
        text = data.decode("utf-8", "surrogateescape").replace("\r\n", "\n")
        if path.suffix in _TEXT and hidden(text):
            found.append(f"{path.suffix}: control or direction character")
    return found


def _toml(data: bytes) -> None:
    tomllib.loads(data.decode("utf-8"))


def _json(data: bytes) -> None:
    json.loads(data.decode("utf-8"), parse_constant=lambda name: 1 / 0)


def _csv(data: bytes) -> None:
    rows = list(csv.reader(StringIO(data.decode("utf-8"), newline=""), strict=True))
    if len({len(row) for row in rows}) > 1:
        raise ValueError("rows of different length")
    for row in rows:
        for cell in row:
            if _FORMULA.match(cell) and not _is_number(cell):
                raise ValueError(f"a formula: {cell[:20]}")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _c_header(data: bytes) -> None:
    flags = ["-std=c99", "-Wall", "-Werror", "-Wno-unused-function", "-fsyntax-only"]
    done = subprocess.run(
        ["cc", *flags, "-x", "c", "-"], input=data, capture_output=True, check=False
    )
    if done.returncode:
        raise ValueError(done.stderr.decode("utf-8", "replace")[:200])


def _mesh(suffix: str) -> Callable[[bytes], None]:
    def read(data: bytes) -> None:
        import trimesh

        mesh: Any = trimesh.load(BytesIO(data), file_type=suffix)
        if not mesh.is_volume:
            raise ValueError("no closed mesh")

    return read


def _svg(data: bytes) -> None:
    ElementTree.fromstring(data)


def _dxf(data: bytes) -> None:
    from ezdxf.filemanagement import read

    if not len(read(StringIO(data.decode("utf-8"))).modelspace()):
        raise ValueError("an empty drawing")


def _step(data: bytes) -> None:
    from OCP.IFSelect import IFSelect_ReturnStatus  # pyright: ignore[reportAttributeAccessIssue]
    from OCP.STEPControl import STEPControl_Reader  # pyright: ignore[reportAttributeAccessIssue]

    with tempfile.NamedTemporaryFile(suffix=".step") as file, tempfile.TemporaryFile() as said:
        file.write(data)
        file.flush()
        reader = STEPControl_Reader()
        stdout = os.dup(1)
        os.dup2(said.fileno(), 1)  # where the reader names syntax that it skips
        try:
            done = (
                reader.ReadFile(file.name) == IFSelect_ReturnStatus.IFSelect_RetDone
                and reader.TransferRoots()
            )
        finally:
            os.dup2(stdout, 1)
            os.close(stdout)
        said.seek(0)
        if not done or b"ERR" in said.read():
            raise ValueError("no STEP file")


def _png(data: bytes) -> None:
    from matplotlib.image import imread

    imread(BytesIO(data), format="png")


def _npz(data: bytes) -> None:
    import numpy as np

    with np.load(BytesIO(data), allow_pickle=False) as arrays:
        for name in arrays:
            arrays[name]


def _parquet(data: bytes) -> None:
    from pyarrow import parquet

    parquet.read_table(BytesIO(data))


READERS: dict[str, Callable[[bytes], None]] = {
    ".toml": _toml,
    ".json": _json,
    ".csv": _csv,
    ".h": _c_header,
    ".stl": _mesh("stl"),
    ".ply": _mesh("ply"),
    ".obj": _mesh("obj"),
    ".svg": _svg,
    ".dxf": _dxf,
    ".step": _step,
    ".png": _png,
    ".npz": _npz,
    ".parquet": _parquet,
    ".txt": lambda data: None,
}
"""File ending → function that raises for a file that a reader of this format rejects."""
