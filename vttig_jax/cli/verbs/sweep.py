"""`vttig sweep`: simulate thousands of cases, the Cartesian product of named axes."""

from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Annotated

import click

from ...base.errors import UsageError
from ...base.files.run_folder import RunFolder
from ...base.logger import LOGGER
from ...base.threads import usable_cores
from ..options import Argument, Dask, exclude_each_other, need, verb
from ..output import Output, adopt_loggers

if TYPE_CHECKING:
    from ...control.sweeps.table import SweepTable

FIGURE = "figures/sweep.png"


@verb(
    "sweep",
    example="""
vttig sweep sweep.toml --out swept
vttig sweep sweep.toml --out swept --resume
vttig sweep sweep.toml --out swept --dask tcp://127.0.0.1:8786
""",
)
def command(
    output: Output,
    *,
    scenario: Annotated[Path, Argument("SWEEP")],
    out: Annotated[Path | None, "Folder for sweep.parquet."],
    resume: Annotated[
        bool, "Go on with the sweep that is unfinished in --out; where there is none, start."
    ],
    overwrite: Annotated[bool, "Replace the sweep in --out."],
    devices: Annotated[
        int | None, click.IntRange(min=1, max=4096), "Cores, or GPUs, to use; all by default."
    ],
    dask: Dask,
    no_figures: Annotated[bool, "Leave the picture out of --out."],
) -> None:
    """Simulate every case of SWEEP (TOML): a scenario with [sweep], whose axes are combined.

    Each row of sweep.parquet is a case: its number, the axes, the metrics of `vttig simulate`, its
    outcome. With rig = { from = "RUN", draws = 200 } every case runs with rigs drawn from the
    posterior in the run folder RUN, while the controllers have the map of its mean. Blocks of cases
    are written as they are done: after Ctrl-C or a kill --resume goes on and ends with the same
    table. A command with --resume may be repeated: it starts, goes on, or only prints the table
    that is complete.
    """
    need("out", "resume", "overwrite", "no_figures")
    exclude_each_other("resume", "overwrite")
    prepare(devices)
    if dask is not None and find_spec("distributed") is not None:
        import distributed  # noqa: F401 -- it adds handlers to its loggers

        adopt_loggers("distributed")
    from ...runs.simulations import sweep

    with output.progress(1, "lane-steps") as bar:

        def announce(size: str, lane_steps: float) -> None:
            output.narrate(f"to run: {size}")
            bar.total = max(lane_steps, 1)
            bar.unit_scale = True
            if out is not None and not no_figures:
                # The modules of the picture are imported while the devices run.
                Thread(target=_import_plots, daemon=True).start()

        found = sweep(
            scenario,
            out=out,
            resume=resume,
            overwrite=overwrite,
            devices=devices,
            dask=dask,
            announce=announce,
            progress=bar.reach,
        )
    if out is not None and not no_figures:
        _draw(found, out)
    output.emit(found.to_json(), found)


def prepare(devices: int | None) -> None:
    """Let JAX use processor cores as `devices` devices, by default all cores.

    **Raises** `UsageError` for more devices than cores, or than JAX has if it is already running.
    """
    import vttig_jax

    if devices is not None and devices > usable_cores():
        raise UsageError(f"--devices {devices} is more than the {usable_cores()} cores there are.")
    try:
        vttig_jax.prepare_cpu(devices or usable_cores())
    except ValueError as error:
        # JAX is already running, so that its number of devices cannot be changed.
        import jax

        there = len(jax.devices())
        if devices is not None and devices > there:
            raise UsageError(f"--devices {devices} is more than the {there} of JAX.") from error


def _import_plots() -> None:
    from ...plotting import save, sweep  # noqa: F401


def _draw(found: "SweepTable", out: Path) -> None:
    """Write the picture of a sweep to the folder `out`, if the sweep has an axis of numbers."""
    from ...plotting.save import png
    from ...plotting.sweep import numeric_axes, plot_sweep

    if not numeric_axes(found):
        LOGGER.info("no axis of numbers: no picture")
        return
    with RunFolder(out, overwrite=True) as folder:
        folder.write_bytes(FIGURE, png(plot_sweep(found)))
