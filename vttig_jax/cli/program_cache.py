"""Storage of compiled programs between runs of the command line.

XLA compiles the programs of a command again in every process. JAX can keep them in a folder, but it
loads an entry (a file with one program) without a check of its content: where the package
`zstandard` is installed, one flipped bit of an entry changed a result or ended the process in 6 of
35 tries. So here every entry begins with the SHA-256 of its name and content. A command copies the
entries that pass the check into a temporary folder, which is the only folder that JAX uses, and
stores the new programs when it ends.
"""

import hashlib
import os
import platform
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from ..base.files.atomic_write import replace_file
from ..base.logger import LOGGER

VARIABLE = "VTTIG_CACHE"
"""Environment variable: the folder of the programs, or "off"."""

_SUFFIX = "-cache"  # of the files of JAX that hold a program
_DIGEST = hashlib.sha256().digest_size
_MOST_BYTES = 128 << 20  # largest total size of the programs of one command; chosen value
_SETTINGS = {
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    "JAX_PERSISTENT_CACHE_ENABLE_XLA_CACHES": "none",
}


@contextmanager
def kept_programs(command: str) -> Iterator[None]:
    """Let JAX use the stored programs of a command, and store its new programs at the end.

    Nothing is stored if the variable `VTTIG_CACHE` is "off", if the user has set a cache folder for
    JAX (`JAX_COMPILATION_CACHE_DIR`), if JAX is already imported, or if the folder cannot be
    written or other users can write to it. A program that fails the check is compiled again.
    """
    folder = _folder()
    if folder is None or "JAX_COMPILATION_CACHE_DIR" in os.environ or "jax" in sys.modules:
        yield
        return
    store = folder / _machine() / command
    try:
        store.mkdir(parents=True, exist_ok=True, mode=0o700)
        _require_private(store, folder)
        stage = TemporaryDirectory(prefix="vttig-", ignore_cleanup_errors=True)  # closed to others
    except OSError as error:
        LOGGER.info("compiled programs are not kept in %s: %s", store, error.strerror or error)
        yield
        return
    with stage as path:
        known = read_programs(store, Path(path))
        settings = {**_SETTINGS, "JAX_COMPILATION_CACHE_DIR": path}
        added = [name for name in settings if name not in os.environ]
        os.environ.update({name: settings[name] for name in added})
        try:
            yield
        finally:
            for name in added:
                os.environ.pop(name, None)
            with suppress(OSError):
                write_programs(Path(path), store, known)


def read_programs(store: Path, stage: Path) -> set[str]:
    """Copy the valid entries of the folder `store` to the folder `stage`, and return their names.

    Entries that fail the check are removed from `store`, and the oldest ones beyond the limit of
    the size.
    """
    found = []
    for path in store.iterdir():
        with suppress(OSError):  # another command has removed it
            found.append((path, path.stat()))
    known, damaged, size = set(), 0, 0
    for path, seen in sorted(found, key=lambda one: (-one[1].st_mtime_ns, one[0].name)):
        size += seen.st_size
        with suppress(OSError):
            if size > _MOST_BYTES:
                path.unlink()
                continue
            data = path.read_bytes()
            if data[:_DIGEST] == _digest(path.name, data[_DIGEST:]):
                (stage / path.name).write_bytes(data[_DIGEST:])
                known.add(path.name)
            elif path.suffix != ".tmp":  # another command is writing it
                damaged += 1
                path.unlink()
    if damaged:
        LOGGER.info("%d stored programs failed their check and are compiled again", damaged)
    return known


def write_programs(stage: Path, store: Path, known: set[str]) -> None:
    """Store the new programs of the folder `stage` in `store`, each atomically with its digest.

    `known` holds the names of the programs that `store` already has.
    """
    for path in stage.iterdir():
        if path.name.endswith(_SUFFIX) and path.name not in known:
            content = path.read_bytes()
            replace_file(store / path.name, _digest(path.name, content) + content)


def _digest(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + b"\0" + content).digest()


def _folder() -> Path | None:
    """Return the folder of the stored programs, or None if the user wants none to be stored."""
    given = os.environ.get(VARIABLE, "")
    if given.lower() == "off":
        return None
    if given:
        return Path(given).expanduser()
    from platformdirs import user_cache_path

    return user_cache_path("vttig")


def _machine() -> str:
    """Return a short digest of everything that a compiled program depends on.

    These are the versions of JAX and Python, the system, the processor and the flags of XLA.
    """
    features = platform.processor()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        features = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    parts = [version("jax"), version("jaxlib"), sys.version, platform.platform(), features]
    parts.append(os.environ.get("XLA_FLAGS", ""))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _require_private(store: Path, folder: Path) -> None:
    """Raise `OSError` if others could write programs into `store`, which this user would run.

    `folder` and everything in it belong to this user alone. Other users must not be able to replace
    one of the folders above it either: those are not writable by all, or sticky like /tmp.
    """
    if not hasattr(os, "getuid"):
        return
    inside = store.resolve()
    for place in (inside, *inside.parents):
        seen = place.stat()
        if place.is_relative_to(folder.resolve()):
            private = seen.st_uid == os.getuid() and not seen.st_mode & 0o022
        else:
            private = not seen.st_mode & 0o002 or bool(seen.st_mode & stat.S_ISVTX)
        if not private:
            raise PermissionError(None, f"other users can write to {place}")
