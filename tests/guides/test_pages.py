"""Every command of README and `docs/` runs, and prints what the page shows below it."""

import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import benchmarks.environment
from tests.guides.pages import REPOSITORY, Fence, commands, fences, pages, text_of
from tests.guides.printed import differences
from tests.guides.readers import (
    DEMO,
    DRAWN_SHARE,
    HAVE,
    NAMED,
    SHORTER,
    files_of,
    with_commands,
    with_demo,
)
from vttig_jax.base.errors import PairError
from vttig_jax.cli.main import main
from vttig_jax.pair.gear_pair import load_pair

QUICK = ("docs/logs.md",)
"""Pages whose commands take a few seconds; the others are slow."""

INSTALLATION = "python -m pip install"


def test_every_page_with_commands_is_run():
    assert {*HAVE, *DEMO, *DRAWN_SHARE} <= set(with_commands()) and set(NAMED) <= set(pages())
    assert len(with_commands()) == 12
    shown = {shlex.join(c) for p in pages() for f in fences(text_of(p)) for c in commands_of(f)}
    assert set(SHORTER) <= shown and len(shown) > 25
    assert {one for one in shown if one.startswith("python -m benchmarks.")} <= set(SHORTER)


def test_no_block_is_of_another_kind():
    """Blocks are commands, what they print, Python, files, one C call and one diagram."""
    kinds = {f.language for page in pages() for f in fences(text_of(page))}
    assert kinds == {"sh", "", "python", "toml", "csv", "c", "mermaid"}


def test_every_page_says_first_what_it_answers():
    for page in pages():
        title, _, rest = text_of(page).partition("\n\n")
        first = rest.partition("\n\n")[0]
        assert title.startswith("# ") and "\n" not in title, page
        assert re.match(r"[A-Z`]", first) and first.rstrip().endswith((".", ":")), page


@pytest.mark.parametrize(
    "page", [pytest.param(p, marks=() if p in QUICK else pytest.mark.slow) for p in with_commands()]
)
def test_the_commands_of_a_page(page, request, tmp_path, monkeypatch, capsys):
    demo = request.getfixturevalue("demo") if page in DEMO else None
    printed = lambda: capsys.readouterr().out  # noqa: E731
    for fence, text in shown_and_printed(page, demo, tmp_path, monkeypatch, printed):
        assert differences(fence.text, text, DRAWN_SHARE.get(page, 0.0)) == []


def shown_and_printed(
    page: str,
    demo: Path | None,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    printed: Callable[[], str],
) -> Iterator[tuple[Fence, str]]:
    """Run the commands of a page in `folder`, and yield every text it shows with what is printed.

    `printed` returns what was printed since its last call.
    """
    monkeypatch.chdir(folder)
    if page in HAVE:
        HAVE[page](folder)
    if demo is not None:
        keep = folder / "pair.toml"
        own = keep.read_text() if keep.exists() else None
        with_demo(folder, demo)
        if own is not None:
            keep.write_text(own)
    if page in NAMED:
        files_of(page, folder)
    monkeypatch.setattr(benchmarks.environment, "RESULTS", folder / "results")
    shown = fences(text_of(page))
    for fence, following in zip(shown, [*shown[1:], None], strict=True):
        text = ""
        for words in commands_of(fence):
            printed()
            assert run(words, monkeypatch) == 0, shlex.join(words)
            text = printed()
            if ">" in words:
                # The page asks the reader to fill in the required keys; their examples serve.
                filled = re.sub(r"(?m)^# ((?:pair|driv|const)\w* = .*# required)", r"\1", text)
                Path(words[-1]).write_text(filled, encoding="utf-8")
        if fence.language == "sh" and following is not None and following.language == "":
            yield following, text


def commands_of(fence):
    """Yield the commands of a block, without the variables that are set before them."""
    if fence.language == "sh":
        for words in commands(fence):
            while re.match(r"[A-Z_]+=", words[0]):
                words = words[1:]
            yield words


def run(words: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    """Run a command in this process, with patterns of file names filled in; the exit code."""
    if shlex.join(words).startswith((INSTALLATION, "python -m pytest")):
        return 0  # `.ci/run` installs the package, and these are the tests
    words = shlex.split(SHORTER.get(shlex.join(words), shlex.join(words)))
    words = words[: words.index(">")] if ">" in words else words
    if words[0] == "vttig":
        found = [sorted(map(str, Path().glob(w))) if "*" in w else [w] for w in words[1:]]
        return main([word for group in found for word in group])
    assert words[:2] == ["python", "-m"]
    monkeypatch.setattr(sys, "argv", words[2:])
    runpy.run_module(words[2], run_name="__main__")
    return 0


def test_ci_installs_as_the_readme_says():
    said = [line for line in text_of("README.md").splitlines() if line.startswith(INSTALLATION)]
    done = (REPOSITORY / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert len(said) == 2 and set(said) <= set(done)


def test_the_files_of_the_page_on_pair_files(tmp_path):
    """The second block shows two files side by side; measures of another page go with the first."""
    one, two = (f.text for f in fences(text_of("docs/pair_file.md")) if f.language == "toml")
    stated = next(f.text for f in fences(text_of("docs/gear.md")) if f.language == "toml")
    rows = [re.split(r" {3,}(?!#)", row) for row in two.splitlines()]
    left = [row[0] for row in rows if row[0]]
    right = [row[-1] for row in rows if len(row) > 1]
    ratios, path = [], tmp_path / "pair.toml"
    for text in (one, "\n".join(left), "\n".join(right), one + stated):
        path.write_text(text, encoding="utf-8")
        ratios.append(str(load_pair(path).ratio))
    assert ratios == ["9/16", "7/1798", "1", "9/16"]
    path.write_text(one + stated.replace("ball_", "bal_"), encoding="utf-8")
    with pytest.raises(PairError, match="bal_diameter_mm"):
        load_pair(path)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_the_call_from_c_compiles(demo, tmp_path):
    out = tmp_path / "compensation.h"
    assert main(["export", str(demo), "--out", str(out), "--name", "axis_2"]) == 0
    shown = next(f.text for f in fences(text_of("docs/on_the_machine.md")) if f.language == "c")
    include, _, body = shown.partition("\n")
    around = "void command(double, double);\nvoid turn(long, long, double);\nvoid turn("
    around += "long driving_counts, long driven_counts, double driving_speed_rad_s) {\n"
    (tmp_path / "call.c").write_text(f"{include}\n{around}{body}}}\n", encoding="utf-8")
    call = ["cc", "-std=c99", "-Wall", "-Werror", "-fsyntax-only", "call.c"]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
