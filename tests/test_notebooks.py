"""Every notebook runs from top to bottom, and carries no output of an earlier run."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

QUICK = ("01_from_log_to_map",)
"""Notebooks that each test run executes; `-m slow` executes the others."""


def execute(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """Run all cells in a kernel whose working folder is `folder`; a failing cell raises."""
    client = NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": folder}}
    )
    return client.execute()


def outputs(notebook: nbformat.NotebookNode) -> list[str]:
    return [
        f"cell {number}"
        for number, cell in enumerate(notebook.cells)
        if cell.cell_type == "code" and (cell.outputs or cell.execution_count is not None)
    ]


def test_there_are_notebooks():
    assert "01_from_log_to_map.ipynb" in {path.name for path in NOTEBOOKS}


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=() if path.stem in QUICK else pytest.mark.slow)
        for path in NOTEBOOKS
    ],
)
def test_notebook_runs(path: Path, tmp_path: Path):
    notebook = nbformat.read(path, as_version=4)
    assert outputs(notebook) == [], "notebooks are kept without outputs"
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert sum(cell.source.startswith("assert") for cell in cells) >= 5
    executed = execute(notebook, tmp_path)
    pictures = sum(
        "image/png" in output.get("data", {})
        for cell in executed.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    )
    assert pictures >= 3


def test_a_false_claim_fails(tmp_path: Path):
    cell = nbformat.v4.new_code_cell("assert 1 + 1 == 3")
    with pytest.raises(CellExecutionError, match="AssertionError"):
        execute(nbformat.v4.new_notebook(cells=[cell]), tmp_path)


def test_outputs_are_seen():
    stream = nbformat.v4.new_output("stream", text="1\n")
    cell = nbformat.v4.new_code_cell("print(1)", outputs=[stream])
    assert outputs(nbformat.v4.new_notebook(cells=[cell])) == ["cell 0"]
