"""Runs notebooks, and keeps what they show.

    python -m tests.guides.notebooks [NAME …]

Executes the notebooks (all by default) and writes them with their texts and pictures, so that a
reader on a code host sees them.
"""

import base64
import sys
import tempfile
from io import BytesIO
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image
from traitlets.config import Config

from tests.guides.pages import REPOSITORY

NOTEBOOKS = sorted((REPOSITORY / "notebooks").glob("*.ipynb"))
LARGEST = 150_000
"""Bytes of a kept notebook."""

WIDTHS, COLOURS = (640, 600, 560, 520, 480), 16
"""Pixels and colours of kept pictures; the first width is taken that keeps a notebook small."""


def execute(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """Return the notebook, run in a kernel in `folder`; a false claim raises."""
    client = NotebookClient(
        nbformat.from_dict(notebook),
        # Nothing listens on a port. The client ends a kernel that it starts itself, and no other.
        config=Config(KernelManager={"transport": "ipc", "ip": str(folder / "kernel")}),
        kernel_name="python3",
        timeout=120,
        resources={"metadata": {"path": folder}},
        record_timing=False,
    )
    return client.execute()


def shown(notebook: nbformat.NotebookNode) -> list[tuple[str, list[str]]]:
    """Return the text and the pictures (PNG, base64) below each cell of code."""
    found = []
    for cell in notebook.cells:
        if cell.cell_type == "code":
            texts, pictures = [], []
            for output in cell.outputs:
                data = output.get("data", {})
                if "image/png" in data:
                    pictures.append(data["image/png"])
                else:
                    texts.append(output.get("text", data.get("text/plain", "") + "\n"))
            found.append(("".join(texts), pictures))
    return found


def light(picture: str, width: int) -> str:
    """Return a PNG of so many pixels with few colours."""
    image = Image.open(BytesIO(base64.b64decode(picture))).convert("RGB")
    image.thumbnail((width, 4 * width), Image.Resampling.LANCZOS)
    buffer = BytesIO()
    image.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        buffer, "PNG", optimize=True
    )
    return base64.b64encode(buffer.getvalue()).decode()


if __name__ == "__main__":
    for path in NOTEBOOKS:
        if not sys.argv[1:] or path.stem in sys.argv[1:]:
            with tempfile.TemporaryDirectory() as folder:
                notebook = execute(nbformat.read(path, as_version=4), Path(folder))
            found = [
                (output, output.data["image/png"])
                for cell in notebook.cells
                for output in cell.get("outputs", [])
                if "image/png" in output.get("data", {})
            ]
            for width in WIDTHS:
                for output, picture in found:
                    output.data = {"image/png": light(picture, width)}
                nbformat.write(notebook, path)
                if path.stat().st_size <= LARGEST:
                    print(path.name, path.stat().st_size, width, flush=True)
                    break
