"""Every notebook runs from top to bottom, and shows what it shows when it runs today."""

import os
from pathlib import Path

import nbformat
import pytest
from nbclient.exceptions import CellExecutionError

from tests.guides.notebooks import LARGEST, NOTEBOOKS, execute, shown
from tests.guides.printed import differences

SHARE = {"04_trusting_the_posterior": 0.2}
"""Notebook → share by which its numbers may differ, because they come from random draws."""


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


def unlike(kept: nbformat.NotebookNode, run: nbformat.NotebookNode, share: float) -> list[str]:
    """Return what the kept outputs have and those of the run have not."""
    found = []
    for number, (own, other) in enumerate(zip(shown(kept), shown(run), strict=True)):
        found += [f"cell {number}: {one}" for one in differences(own[0], other[0], share)]
        if len(own[1]) != len(other[1]):
            found.append(f"cell {number}: {len(own[1])} pictures, not {len(other[1])}")
    return found


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_what_it_shows_when_it_runs(path, tmp_path):
    notebook = read(path)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert sum(cell.source.startswith("assert") for cell in cells) >= 5
    run = execute(notebook, tmp_path)
    if "measured logs are not on this machine" in str(shown(run)):
        pytest.skip("the measured logs are not on this machine")
    assert unlike(notebook, run, SHARE.get(path.stem, 0.0)) == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_with_small_pictures(path):
    assert path.stat().st_size <= LARGEST
    assert sum(len(pictures) for _, pictures in shown(read(path))) >= 3


def cell(source: str, text: str) -> nbformat.NotebookNode:
    stream = nbformat.v4.new_output("stream", text=text)
    return nbformat.v4.new_code_cell(source, outputs=[stream])


def test_another_number_and_a_false_claim_are_seen_and_no_kernel_is_left(tmp_path):
    kept = nbformat.v4.new_notebook(
        cells=[cell("print(1.25)", "1.35\n"), cell("import os; print(os.getpid())", "")]
    )
    run = execute(kept, tmp_path)
    (problem,) = unlike(kept, run, 0.0)
    assert "1.35" in problem and "1.25" in problem
    with pytest.raises(ProcessLookupError):
        os.kill(int(shown(run)[1][0]), 0)
    false = nbformat.v4.new_notebook(cells=[cell("assert 1 + 1 == 3", "")])
    with pytest.raises(CellExecutionError, match="AssertionError"):
        execute(false, tmp_path)
