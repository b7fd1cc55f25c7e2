"""Refusal to write over files of others that have the name of a result."""

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

BESIDE = ("figures", "map.csv", "map.json")
"""Names that a command may write beside the files of `RESULTS`."""


def refuse_foreign(
    folder: str | Path, *, overwrite: bool, written: tuple[str, ...] = BESIDE
) -> None:
    """Raise `UsageError` if files of others in a folder have names that a command writes.

    These names are `written`. In a folder with a result of this package they belong to it, and so
    do they where a killed command left its hidden files. Files with other names stay as they are,
    so that results may stand beside the log. `overwrite` is the user's consent.

    **Example**
    ```python
    >>> import tempfile
    >>> from pathlib import Path
    >>> from vttig_jax.base.files.foreign_folder import refuse_foreign
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     (Path(folder) / "log.csv").touch()
    ...     refuse_foreign(folder, overwrite=False)
    ...     (Path(folder) / "figures").mkdir()
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
    others = [name for name in names if name in written]
    if others:
        raise UsageError(
            f"this folder holds {' and '.join(others)}, which the command writes, and no result of"
            f" vttig that {'it' if len(others) == 1 else 'they'} could belong to; name another"
            f" folder, such as {path / 'run'}, or write over {'it' if len(others) == 1 else 'them'}"
            " with --overwrite (in Python overwrite=True).",
            where=str(path),
        )
