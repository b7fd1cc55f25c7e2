"""The Python of README and `docs/` runs, and shows the values that the pages print."""

from typing import Any

import pytest

import vttig_jax
from tests.guides.pages import fences, pages, text_of
from tests.guides.readers import with_a_sweep, with_own_log
from tests.test_docstrings import run

WITH_CODE = [page for page in pages() if any(f.language == "python" for f in fences(text_of(page)))]

QUICK = ("docs/logs.md", "docs/python.md", "README.md")
"""Pages whose code takes a few seconds; the others are slow."""


BEFORE = {"docs/logs.md": with_own_log, "docs/simulation.md": with_a_sweep}
"""Page → what writes the files that its code takes for given."""


@pytest.mark.parametrize(("page", "number"), [("docs/many_fits.md", 2), ("docs/own_model.md", 3)])
def test_examples_of_advanced_use_are_short(page, number):
    assert len(WITH_CODE) == 7 and {*BEFORE, *QUICK} <= set(WITH_CODE)
    blocks = [one.text for one in fences(text_of(page)) if one.language == "python"]
    assert len(blocks) == number
    assert max(sum(bool(line.strip()) for line in text.splitlines()) for text in blocks) <= 10


@pytest.mark.parametrize(
    "page", [pytest.param(p, marks=() if p in QUICK else pytest.mark.slow) for p in WITH_CODE]
)
def test_the_code_of_a_page(page, tmp_path, monkeypatch, capsys):
    """A block goes on where the one before it ended; it shows values or checks itself."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"vttig_jax": vttig_jax}  # a page may import it elsewhere
    BEFORE.get(page, lambda _: None)(tmp_path)
    for fence in fences(text_of(page)):
        if fence.language != "python":
            continue
        if ">>>" in fence.text:
            problem = run(page, fence.text)
            assert not problem, problem
        else:
            assert "assert " in fence.text or page in BEFORE
            exec(compile(fence.text, page, "exec"), names)
    if page == "docs/logs.md":
        assert set(names["fit"].flanks) == {"A", "B"}
        assert str(names["fit"].pair.ratio) == "23/64"
    if page == "docs/simulation.md":
        assert names["tuned"].after.cost_deg <= names["tuned"].before.cost_deg
