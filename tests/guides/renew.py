"""Renews what commands print in the README and in `docs/`.

    python -m tests.guides.renew [PAGE …]

Runs the commands of the pages (all by default) as the tests do, and writes what they print in place
of every text that differs, and the pictures that they draw. A page shows the report up to the row
that its text ended with.
"""

import io
import re
import shutil
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path

import pytest

import vttig_jax
from tests.guides.pages import REPOSITORY, text_of
from tests.guides.printed import differences
from tests.guides.readers import DEMO, DRAWN_SHARE, with_commands
from tests.guides.test_pages import shown_and_printed
from vttig_jax.cli.main import main


def excerpt(shown: str, printed: str) -> str:
    """Return the printed text up to the row that begins like the last one of `shown`."""
    rows, seen = shown.strip("\n").splitlines(), printed.strip("\n").splitlines()
    begin = rows[-1].split()[:1]
    ends = [place for place, row in enumerate(seen) if begin and row.split()[:1] == begin]
    end = min(ends, key=lambda place: abs(place - len(rows) + 1), default=len(rows) - 1)
    return "\n".join(row.rstrip() for row in seen[: end + 1]) + "\n"


def renewed(page: str, demo: Path) -> str:
    """Return the text of a page with what its commands print today."""
    text, sink = text_of(page), io.StringIO()

    def printed() -> str:
        said = sink.getvalue()
        sink.seek(0)
        sink.truncate()
        return said

    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        found = shown_and_printed(
            page, demo if page in DEMO else None, Path(folder), patch, printed
        )
        with redirect_stdout(sink):
            for fence, said in found:
                if differences(fence.text, said, DRAWN_SHARE.get(page, 0.0)):
                    own = f"```\n{fence.text}```\n"
                    text = text.replace(own, f"```\n{excerpt(fence.text, said)}```\n")
        for picture in re.findall(r"!\[[^]]*\]\((\w+\.png)\)", text):
            shutil.copy(Path(folder) / picture, (REPOSITORY / page).with_name(picture))
    return text


if __name__ == "__main__":
    vttig_jax.enable_x64()
    with tempfile.TemporaryDirectory() as kept:
        demo = Path(kept) / "demo"
        assert main(["demo", "--out", str(demo), "--quiet"]) == 0
        for page in sys.argv[1:] or with_commands():
            try:
                (REPOSITORY / page).write_text(renewed(page, demo), encoding="utf-8")
                print(page, flush=True)
            except pytest.skip.Exception as reason:
                print(f"{page} is as it was: {reason}", flush=True)
