"""Renews the run folders of measured logs in `fits/` and what their READMEs show.

    python -m tests.fits.renew [RIG …]

Runs the commands and the code of each README (of all rigs by default) and writes what they print in
place of the text below them. A run folder keeps its record, its result and the pictures of the
README.
"""

import io
import os
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import vttig_jax
from tests.test_fits import FITS, MEASURED, REPOSITORY, shown_runs
from vttig_jax.cli.main import main


def printed_by(kind: str, source: str) -> str:
    """Return what a command or a piece of code of a README prints."""
    if source.startswith("python"):
        return subprocess.check_output([sys.executable, *source.split()[1:]], text=True)
    with redirect_stdout(io.StringIO()) as sink:
        if kind == "python":
            exec(compile(source, "README.md", "exec"), {})
        else:
            arguments = shlex.split(source)[1:]
            renews = ["--overwrite"] if "--out" in arguments else []
            assert main([*arguments, *renews]) == 0, source
    return sink.getvalue()


def renew(rig: Path) -> None:
    """Renew the README and the run folders of a rig."""
    readme = rig / "README.md"
    text = readme.read_text(encoding="utf-8")
    for kind, source, shown in shown_runs(text):
        print(rig.name, source.splitlines()[0], flush=True)
        text = text.replace(f"{shown}\n", f"{printed_by(kind, source).strip()}\n", 1)
        readme.write_text(text, encoding="utf-8")
    for run in [path.parent for path in rig.glob("*/run.toml")]:
        for path in sorted(run.rglob("*"), reverse=True):
            kept = path.name in ("run.toml", "fit.json", "figures")
            if not kept and path.relative_to(rig).as_posix() not in text:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


if __name__ == "__main__":
    os.chdir(REPOSITORY)
    vttig_jax.enable_x64()
    for name in sys.argv[1:] or MEASURED:
        renew(FITS / name)
