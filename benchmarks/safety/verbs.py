"""Commands with a run folder, for studies that stop them: how they start and are compared."""

import hashlib
import io
import json
import os
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.cli.drive import write_drive
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

from .calls import call
from .inputs import in_a_fork, write_inputs

Content = str
"""Digest of a result, "none" for no result, or "mixture: …"."""


@dataclass(frozen=True)
class Verb:
    """One command: its arguments without --out, and how its folder is read.

    **Arguments**
    - `arguments`: of the first call; `old`: of a call with another result, for --overwrite.
    - `content`: digest of the result in a folder.
    - `resumes`: whether the call is repeated with --resume after it was stopped.
    - `before`: called in the process of the command, for example to make blocks small.
    """

    arguments: tuple[str, ...]
    old: tuple[str, ...]
    content: Callable[[Path], Content]
    resumes: bool
    before: Callable[[], None] = lambda: None


def write_all(folder: Path) -> None:
    """Write the inputs of all these commands."""
    write_inputs(folder)
    write_drive(folder / "other.csv", seed=1)

    def rigs() -> None:
        for number in range(4):
            rig = paper_rig(number, PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
            (folder / f"rig{number}.csv").write_text(log_csv(rig.log(number)))

    in_a_fork(rigs)
    text = (folder / "sweep.toml").read_text()
    (folder / "sweep.toml").write_text(text.replace("num = 3", "num = 24"))
    (folder / "sweep2.toml").write_text(text.replace("to = 240", "to = 230"))


def _fit(folder: Path) -> Content:
    """Return the digest that all files of a fit carry, after a reader has settled the folder."""
    import vttig_jax

    def settle() -> None:
        _ = vttig_jax.open_run(folder).fit

    if folder.exists():
        in_a_fork(settle)
    if not (folder / "fit.json").exists():
        return "none"
    runs = {
        "fit.json": json.loads((folder / "fit.json").read_text())["run"],
        "run.toml": tomllib.loads((folder / "run.toml").read_text())["run"],
    }
    with np.load(folder / "summary.npz") as arrays:
        runs["summary.npz"] = str(arrays["run"])
    for path in folder.glob("figures/*.png"):
        from PIL import Image

        runs[path.name] = str(Image.open(path).info.get("Source", "")).removeprefix("run ")
    return runs["fit.json"] if len(set(runs.values())) == 1 else f"mixture: {runs}"


def _table(name: str) -> Callable[[Path], Content]:
    def content(folder: Path) -> Content:
        from pyarrow import parquet

        path = folder / name
        if not path.exists():
            return "none"
        # From a copy in memory: threads of the reader may keep the file open after the call.
        table = parquet.read_table(io.BytesIO(path.read_bytes()))
        digest = hashlib.sha256(repr(table.schema.names).encode())
        for column in table.columns:
            digest.update(repr(column.to_pylist()).encode())
        return digest.hexdigest()

    return content


def _draws(folder: Path) -> Content:
    import h5py

    path = folder / "posterior.h5"
    if not (folder / "posterior.json").exists() or not path.exists():
        return "none"
    digest = hashlib.sha256()

    def take(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf":
            digest.update(name.encode() + item[()].tobytes())

    with h5py.File(path, "r") as file:
        file.visititems(take)
    return digest.hexdigest()


def _small_blocks() -> None:
    from vttig_jax.control.sweeps import sweep as work

    work._LEAST = work._MOST = 4


def _one_log_a_block() -> None:
    from vttig_jax.runs import many_fits

    many_fits._BLOCK = 1


def _small_pictures() -> None:
    from matplotlib.figure import Figure

    from vttig_jax.plotting import save

    names = ("te_fit.png", "orders.png", "residual.png", "backlash_map.png")
    save.figures = lambda fit, grid, *, run="": {  # pyright: ignore[reportAttributeAccessIssue]
        name: save.png(Figure(figsize=(1, 1)), run=run) for name in names
    }


def _save_often() -> None:
    from vttig_jax.posterior import checkpoint

    checkpoint.SAVE_S = checkpoint.SLOWER = 0.0


_PAIR = ("--pair", "pair.toml")
_RIGS = ("--pair", "gears.toml")
_DRAWS = ("--steps", "420", "--walkers", "32", "--ensembles", "4", "--no-figures")
VERBS = {
    "fit": Verb(
        ("fit", "log.csv", *_PAIR), ("fit", "other.csv", *_PAIR), _fit, False, _small_pictures
    ),
    "sample": Verb(
        ("sample", "log.csv", *_PAIR, *_DRAWS),
        ("sample", "other.csv", *_PAIR, *_DRAWS),
        _draws,
        True,
        _save_often,
    ),
    "sweep": Verb(
        ("sweep", "sweep.toml", "--no-figures"),
        ("sweep", "sweep2.toml", "--no-figures"),
        _table("sweep.parquet"),
        True,
        _small_blocks,
    ),
    "fit-many": Verb(
        ("fit-many", *(f"rig{k}.csv" for k in range(4)), *_RIGS),
        ("fit-many", "rig0.csv", *_RIGS),
        _table("fits.parquet"),
        True,
        _one_log_a_block,
    ),
}
"""Name → command."""


def reference(verb: Verb, base: Path, name: str, *, old: bool = False) -> Content:
    """Make the result of an undisturbed run in a folder of `base`, and return its content."""
    arguments = verb.old if old else verb.arguments
    shutil.rmtree(base / name, ignore_errors=True)
    ended = call([*arguments, "--out", name], base, before=verb.before)
    if ended.code not in (0, 5):
        raise RuntimeError(ended.err.decode())
    content = verb.content(base / name)
    if content.startswith(("none", "mixture")):
        raise RuntimeError(f"the result of an undisturbed run is read as {content}")
    return content


def left_over(folder: Path) -> list[str]:
    """Return the names of temporary files below a folder."""
    return [
        name
        for _, folders, files in os.walk(folder)
        for name in (*folders, *files)
        if name.startswith((".new-", ".commit-")) or name.endswith(".tmp")
    ]
