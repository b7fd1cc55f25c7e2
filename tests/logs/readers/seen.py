"""What a user sees of a file: the names of its columns, or one sentence."""

import contextlib
import io
import json
from pathlib import Path

from vttig_jax.cli.main import main


def seen(path: Path) -> tuple[int, list[str] | str]:
    """Return the exit code of `inspect`, and the columns or the sentence of the refusal."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = main(["inspect", str(path), "--json"])
    report = json.loads(out.getvalue())
    return code, [one["name"] for one in report["columns"]] if code == 0 else report["message"]
