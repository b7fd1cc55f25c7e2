"""Refusal to write results into a folder that holds other files."""

from pathlib import Path

from ..errors import UsageError
from .atomic_write import os_errors_as_input_errors

RESULTS = frozenset(
    {
        "run.toml",
        "fit.json",
        "summary.npz",
        "posterior.h5",
        "posterior.json",
        "sweep.json",
        "sweep.parquet",
        "fits.json",
        "fits.parquet",
        "calibration.json",
        "contact.csv",
        "contact.json",
    }
)
"""Names of the files that mark a folder as one of this package: results, also unfinished ones."""

_OURS = (".lock", ".new-")
"""Beginnings of hidden names that a writer leaves in a folder when it is killed."""

_SHOWN = 3  # names of files in the message; chosen value


def refuse_foreign(folder: str | Path, *, overwrite: bool) -> None:
    """Raise `UsageError` for a folder with other files and without any result of this package.

    A folder that does not exist or is empty passes, and so does one that a killed command left.
    Hidden files of others, such as `.DS_Store`, do not count. `overwrite` is the user's consent.

    **Example**
    ```python
    >>> import tempfile
    >>> from pathlib import Path
    >>> from vttig_jax.base.files.foreign_folder import refuse_foreign
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     refuse_foreign(folder, overwrite=False)
    ...     (Path(folder) / "thesis.tex").touch()
    ...     refuse_foreign(folder, overwrite=True)
    ...     try:
    ...         refuse_foreign(folder, overwrite=False)
    ...     except Exception as error:
    ...         print(type(error).__name__)
    UsageError

    ```
    """
    path = Path(folder)
    if overwrite or not path.is_dir():
        return
    with os_errors_as_input_errors(path):
        names = sorted(one.name for one in path.iterdir())
    if any(name in RESULTS or name.startswith(_OURS) for name in names):
        return
    others = [name for name in names if not name.startswith(".")]
    if not others:
        return
    shown = ", ".join(others[:_SHOWN])
    if len(others) > _SHOWN:
        shown += f" and {len(others) - _SHOWN} more"
    raise UsageError(
        f"this folder holds other files ({shown}) and no result of vttig; name a new or an empty"
        f" folder, such as {path / 'run'}, or write beside these files with --overwrite (in Python"
        " overwrite=True).",
        where=str(path),
    )
