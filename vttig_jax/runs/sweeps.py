"""Sweeps in a folder, block by block, here or on a cluster; reading of a finished sweep."""

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax

from ..base.errors import InputError, UsageError
from ..base.files.json_io import dumps
from ..base.runtime import enable_x64, prepare_cpu
from ..control.scenario.spec import parse_scenario_spec
from ..control.simulation.case import METRICS
from ..control.sweeps.sweep import SweepCases, SweepWork, cases_of, sweep
from ..control.sweeps.table import Rows, SweepTable
from .elsewhere import Blocks, run_on_cluster
from .row_store import HEADER, TABLE, SweepFolder, is_complete, read_table


def sweep_in_folder(
    *inputs: Any,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    dask: str | None = None,
    **options: Any,
) -> SweepTable:
    """Run a sweep with the arguments of `vttig_jax.sweep`; `inputs` are those of `cases_of`."""
    spec, pair, folder, controller, maps = inputs
    if (resume or overwrite) and out is None:
        raise ValueError("Argument `out` must name a folder for `resume` and `overwrite`.")
    if resume and out is not None and is_complete(Path(out), (cases := cases_of(*inputs)).header):
        known = {"pair": cases.pair.name, "closing": cases.closing}
        return replace(read_sweep(out), run_s=0.0, compile_s=0.0, **known)
    if out is not None:
        path = Path(out)
        options["store"] = lambda header: SweepFolder(path, header, resume, overwrite)
    if dask is not None:
        options["elsewhere"] = lambda *work: run_on_cluster(dask, Blocks(_block, *work))
    table = sweep(spec, pair, folder=folder, controller=controller, maps=maps, **options)
    return table if out is None else replace(table, path=Path(out) / TABLE)


def _block(number: int, shared: SweepCases) -> tuple[int, int, Rows]:
    """Run a block of the shared cases on a worker; return its number, lane-steps and rows."""
    key, steps = dumps(shared.header), list[int]()
    if key not in _WORK:
        with suppress(ValueError):  # raised where another sweep has already run
            prepare_cpu()
        enable_x64()
        _WORK.clear()
        _WORK[key] = SweepWork(shared, jax.devices()[:1])
    rows = _WORK[key].run(number, steps.append)
    return number, sum(steps), rows


_WORK: dict[str, SweepWork] = {}
"""Header of a sweep → its work with the compiled programs of this worker; at most one sweep."""


def read_sweep(folder: str | Path) -> SweepTable:
    """Read the finished sweep of a folder; its run times are not stored and are NaN.

    **Raises** `UsageError` if the folder contains no finished sweep, `InputError` if it is damaged.
    """
    folder = Path(folder)
    if not (folder / TABLE).is_file():
        raise UsageError(
            f"no finished sweep here ({TABLE} is missing); make one with `vttig sweep SWEEP --out"
            f" {folder}`, or go on with --resume.",
            where=str(folder),
        )
    try:
        record = json.loads((folder / HEADER).read_text(encoding="utf-8"))["scenario"]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"the header of this sweep is damaged ({type(error).__name__}); make it anew with"
            " --overwrite.",
            where=str(folder / HEADER),
        ) from None
    spec = parse_scenario_spec(record, str(folder / HEADER))
    columns = read_table(folder / TABLE)
    axes = tuple(name for name in columns if name not in ("case", "outcome", *METRICS))
    return SweepTable(spec, Path(spec.pair).stem, columns, axes, path=folder / TABLE)
