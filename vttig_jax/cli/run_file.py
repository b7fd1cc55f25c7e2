"""`run.toml`: what made a run folder, so that it can be read again and repeated."""

import os
import tomllib
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..base.errors import InputError, UsageError
from ..base.runfolder import data_sha256
from ..pair.spec import PairSpec, parse_pair_spec, spec_table

SCHEMA = "vttig.run/1"
_PACKAGES = ("vttig-jax", "jax", "jaxlib", "equinox", "optimistix", "numpy", "scipy")


@dataclass(frozen=True)
class Run:
    """One call of `vttig fit`, resolved.

    **Arguments**
    - `log`: the log file; `spec`: the pair file it was read with.
    - `options`: the options of the fit, all of them, by name.
    - `sha256`: of the log; empty before it was read.
    """

    log: Path
    spec: PairSpec
    options: dict[str, Any] = field(default_factory=dict)
    sha256: str = ""

    def table(self, folder: Path) -> dict[str, Any]:
        """The TOML table; the log is named relative to the run folder."""
        return {
            "schema": SCHEMA,
            "versions": {name: version(name) for name in _PACKAGES},
            "data": {
                "log": Path(os.path.relpath(self.log.resolve(), folder.resolve())).as_posix(),
                "sha256": self.sha256,
            },
            "options": {name: value for name, value in self.options.items() if value is not None},
            "pair_file": spec_table(self.spec),
        }


def read_run(path: Path) -> Run:
    """Read a `run.toml`, or that of a run folder.

    **Raises** `UsageError` where there is none, `InputError` where it is no run of this format.
    """
    path = path / "run.toml" if path.is_dir() else path
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UsageError(
            "no such run; make one with `vttig fit LOG --pair PAIR --out DIR`.", where=str(path)
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"not a run file: {error}.", where=str(path)) from None
    if table.get("schema") != SCHEMA:
        raise InputError(
            f"its schema is {table.get('schema')!r}, but this version reads {SCHEMA!r}.",
            where=str(path),
        )
    try:
        data = table["data"]
        spec = parse_pair_spec(table["pair_file"], f"{path}: pair_file")
        return Run(path.parent / data["log"], spec, table["options"], data["sha256"])
    except (KeyError, TypeError) as error:
        raise InputError(f"the entry {error} is missing or damaged.", where=str(path)) from None


def require_same_data(run: Run) -> None:
    """Refuse to repeat a run whose log has changed since."""
    if not run.log.is_file():
        raise InputError("the log of this run is no longer there.", where=str(run.log))
    if run.sha256 != data_sha256([run.log])[0]:
        raise InputError(
            "this log has changed since the run (its SHA-256 differs); fit it anew with --pair.",
            where=str(run.log),
        )
