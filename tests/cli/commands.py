"""Commands and files that the tests of several verbs need."""

from pathlib import Path

import numpy as np
import tomli_w

from tests.control.texts import RIG
from vttig_jax.base.units import DEG
from vttig_jax.cli.main import main
from vttig_jax.logs import EncoderLog
from vttig_jax.pair.gear_pair import spec_of
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.rig.paper import paper_pair

PAPER = Path(__file__).parents[2] / "fits" / "paper" / "pair.toml"
"""Pair file of the paper's rig with what its drawing states."""


def write_paper_pair(path: Path) -> Path:
    """Write a pair file of the paper's rig."""
    path.write_text(tomli_w.dumps(spec_table(spec_of(paper_pair()))))
    return path


def fit_into(out: Path, log: Path, pair: Path, *options: str) -> Path:
    """Fit a log without pictures, and return the run folder."""
    arguments = ["fit", log, "--pair", pair, "--out", out, "--no-figures", *options]
    assert main([str(one) for one in arguments]) == 0
    return out


def write_sweep(folder: Path, text: str) -> Path:
    """Write a sweep of the paper's gears, whose text has the place `{rig}`, and their pair file."""
    write_paper_pair(folder / "pair.toml")
    path = folder / "sweep.toml"
    path.write_text(text.format(rig=tomli_w.dumps(RIG)))
    return path


def row_of(text: str, label: str) -> str:
    """Return what stands behind the name of a row in a report, of which there is one."""
    (line,) = [line for line in text.splitlines() if line.startswith(f"  {label}  ")]
    return line.removeprefix(f"  {label}").strip()


def table_of(path: Path) -> np.ndarray:
    """Return the named columns of a CSV file."""
    return np.genfromtxt(path, delimiter=",", names=True)


def write_log(
    path: Path, log: EncoderLog, driving: str = "driving", driven: str = "driven"
) -> Path:
    """Write time and angles of a log; other names exchange its columns."""
    angles = [getattr(log, f"{shaft}_angle") / DEG for shaft in (driving, driven)]
    head = "time_s,driving_deg,driven_deg"
    table = np.stack([log.time, *angles], axis=1)
    np.savetxt(path, table, "%.9f", ",", header=head, comments="")
    return path
