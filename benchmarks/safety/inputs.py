"""Valid inputs of all commands in one folder, which studies then spoil."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import tomli_w

from tests.cli.drive import write_drive, write_pair
from vttig_jax.base.runtime import enable_x64
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.pair.gear_pair import spec_of
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_pair, paper_rig

from .calls import call

DRIVE = {"drive": {"ratio": "1/2"}, "fit": {"driving_orders": [1, 2], "driven_orders": [1, 2]}}

SCENARIO = """
pair = "gears.toml"
plant = "rigid"
controller = "none"
[eccentricities]
driving_mm = 0.0226
driving_phase_deg = 49.5
driven_mm = 0.0273
driven_phase_deg = 79.3
constant_backlash_deg = 0.038
[motion]
reversal_deg = 200.0
dwell_s = 0.2
ramp_s = 0.2
"""
SWEEP = SCENARIO + '[sweep]\n"motion.reversal_deg" = { from = 200, to = 240, num = 3 }\n'

GEARS = spec_table(spec_of(paper_pair()))
"""Table of the pair file of the paper's gears."""


def write_inputs(folder: Path) -> None:
    """Write a log, a pair, gears, a scenario, a sweep, and the run folder of a fit."""
    write_drive(folder / "log.csv")
    write_pair(folder / "pair.toml")
    (folder / "plain.toml").write_text(tomli_w.dumps(DRIVE))
    (folder / "gears.toml").write_text(tomli_w.dumps(GEARS))
    (folder / "scenario.toml").write_text(SCENARIO)
    (folder / "sweep.toml").write_text(SWEEP)
    _write_log_of_gears(folder / "gears.csv")
    fit = ["fit", "log.csv", "--pair", "pair.toml", "--out", "run", "--no-figures", "-q"]
    ended = call(fit, folder)
    if ended.code:
        raise RuntimeError(ended.err.decode())


def _write_log_of_gears(path: Path) -> None:
    def simulate() -> None:
        path.write_text(log_csv(paper_rig(1, PassMotion(reversal_deg=2160.0)).log(1)))

    in_a_fork(simulate)
    if not path.exists():
        raise RuntimeError("the log of the gears could not be simulated")


def in_a_fork(function: Callable[[], None]) -> None:
    """Call a function in a forked process, because a process that has computed is not forked."""
    child = os.fork()
    if child == 0:
        with suppress(BaseException):
            enable_x64()
            function()
        os._exit(0)
    os.waitpid(child, 0)
