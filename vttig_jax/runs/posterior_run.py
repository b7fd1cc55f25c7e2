"""Posterior of a run folder: its report, `posterior.json`, the map with bands and the pictures."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.errors import NoAnswerError, UsageError
from ..base.files.atomic_write import settle_if_free
from ..base.files.json_io import dumps, read_json
from ..base.files.run_folder import RunFolder
from .fit_run import save_fit
from .map_table import banded_table, csv_text
from .run_file import CHECKPOINT

if TYPE_CHECKING:
    from ..posterior.summary.bands import BandedMap
    from ..posterior.summary.posterior import Posterior

REPORT = "posterior.json"
FIGURES = tuple(f"figures/{name}.png" for name in ("corner", "trace", "band"))
"""Pictures of the posterior draws in a run folder."""


def banded_of(posterior: "Posterior") -> "BandedMap | None":
    """Return the backlash map of a posterior with its bands; None if its logs tell no gap."""
    from ..posterior.summary.bands import band_map

    try:
        return band_map(posterior)
    except NoAnswerError:
        return None


def save_posterior(
    posterior: "Posterior",
    folder: str | Path,
    *,
    overwrite: bool = False,
    figures: bool = True,
) -> None:
    """Write the draws, their report, the map with its bands and the pictures into a run folder.

    The fit of the posterior is written first if the folder does not contain it. `vttig sample
    --resume` can continue the draws. Draws that `sample(…, checkpoint=…, resume=True)` continued
    in this folder need no `overwrite`: their report replaces that of the shorter chains.

    **Arguments**
    - `posterior`: result of `vttig_jax.sample`, or the posterior of an open run.
    - `folder`: run folder; it is created if it does not exist.
    - `overwrite`: replace the fit and the draws that are in the folder.
    - `figures`: draw the pictures too.

    **Raises** `UsageError` for existing draws or another fit without `overwrite`, and if another
    process writes to the folder; `InputError` for a full disk, missing permission and a path that
    is not a folder.
    """
    folder = Path(folder)
    settle_if_free(folder)
    if not _holds(folder, posterior):
        if (folder / "fit.json").exists() and not overwrite:
            raise UsageError(
                "this folder holds another fit than that of the draws; choose another folder, or"
                " replace it with overwrite=True.",
                where=str(folder),
            )
        save_fit(posterior.fit, folder, overwrite=overwrite, figures=figures)
    place = folder / CHECKPOINT
    longer = not overwrite and not _is_reported(folder, posterior)
    longer = longer and place.exists() and posterior.chains.continues(place)
    posterior.chains.save(place, overwrite=overwrite or longer)
    write_report(folder, posterior, banded_of(posterior), figures=figures)


def _holds(folder: Path, posterior: "Posterior") -> bool:
    """Return whether `fit.json` in a folder equals the fit from which the posterior was drawn."""
    stored, drawn = read_json(folder / "fit.json"), json.loads(dumps(posterior.fit.to_json()))
    if isinstance(stored, dict):
        for digest in ("run", "arrays"):
            stored.pop(digest, None)
    return stored == drawn


def _is_reported(folder: Path, posterior: "Posterior") -> bool:
    """Return whether the report in a folder states as many steps as the chains of `posterior`."""
    try:
        return read_json(folder / REPORT)["diagnosis"]["steps"] == posterior.diagnosis.steps
    except (KeyError, TypeError):
        return False


def write_report(
    folder: Path, posterior: "Posterior", banded: "BandedMap | None", *, figures: bool = True
) -> None:
    """Write `posterior.json`, the map with its bands, and the pictures.

    If the folder has a report on chains with another number of steps, its pictures are removed,
    even without `figures`.
    """
    from ..plotting.save import figures as pictures

    outdated = () if _is_reported(folder, posterior) else (*FIGURES, "report.html")
    run = (read_json(folder / "fit.json") or {}).get("run", "")
    with RunFolder(folder, overwrite=True, results=(REPORT,)) as writer:
        for name in outdated:
            writer.discard(name)
        if figures:
            for name, data in pictures(posterior, banded, run=run).items():
                writer.write_bytes(f"figures/{name}", data)
        if banded is not None:
            found = banded_table(banded, posterior.fit, Path("map.csv"))
            writer.write_text("map.csv", csv_text(found.columns))
            writer.write_text("map.json", dumps(found.record | {"run": run}) + "\n")
        writer.write_text(REPORT, dumps(posterior.to_json() | {"run": run}) + "\n")
