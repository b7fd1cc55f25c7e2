"""Calls of `vttig` in forked processes, with a limit of time and of memory.

The parent has imported the libraries, but has started no computation, so that a call costs no
start of Python. What reaches the descriptors 1 and 2 is caught, also from compiled libraries.
"""

import atexit
import io
import os
import re
import shutil
import signal
import sys
import tempfile
import time
import unicodedata
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

LIMIT_S = 60.0
"""Longest time of the processor for a call; other programs on the machine do not count."""

NO_END_S = 600.0
"""Wall time after which a call is killed; chosen value."""

LIMIT_BYTES = 2 << 30
"""Largest resident memory of a call, with about 0.4 GiB of libraries."""

_POLL_S = 0.01
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")

_LIBRARY = re.compile(
    r"(^|\s)\w*(Warning|Error|Exception): |site-packages|warnings\.warn|^[IWEF]\d{4} |"
    r"Exception ignored|\[\w[\w.]* (?:WARNING|ERROR|INFO)\]|^Error in |free\(\): |Fatal Python",
    re.MULTILINE,
)
"""What messages of other libraries look like."""


@dataclass(frozen=True)
class Ended:
    """End of one call: exit code (negative: signal), streams, time of processor, memory."""

    arguments: tuple[str, ...]
    code: int
    out: bytes
    err: bytes
    cpu_s: float
    peak_bytes: int

    def faults(self) -> list[str]:
        """Return the kinds of faults of this call; an empty list is wanted."""
        text = self.out.decode("utf-8", "surrogateescape") + self.err.decode(
            "utf-8", "surrogateescape"
        )
        errors = [line for line in self.err.decode("utf-8", "replace").split("\n") if line]
        named = [line for line in errors if line.startswith("error: ")]
        found = []
        if hidden(text):
            found.append("control or direction character")
        if re.search("^Traceback", text, re.MULTILINE):
            found.append("traceback")
        if self.code == 1:
            found.append("exit 1")
        if self.code < 0:
            found.append(f"signal {-self.code}")
        if self.cpu_s > LIMIT_S:
            found.append("over 60 s")
        if self.peak_bytes > LIMIT_BYTES:
            found.append("over 2 GiB")
        if self.code in (2, 3, 4, 5) and len(named) != 1:
            found.append(f"{len(named)} sentences of error")
        if self.code != 1 and _LIBRARY.search(self.err.decode("utf-8", "replace")):
            found.append("message of a library")
        return found


def hidden(text: str) -> list[str]:
    """Return the characters of a text that show nothing, without the ends of lines."""
    kinds = ("Cc", "Cf", "Zl", "Zp", "Cs")
    return [mark for mark in text if mark != "\n" and unicodedata.category(mark) in kinds]


def preload() -> None:
    """Import all that the commands need, without starting a computation.

    `vttig` keeps no compiled programs where JAX is imported already, so JAX keeps them itself.
    """
    programs = tempfile.mkdtemp(prefix="programs-")
    atexit.register(_remove_as, os.getpid(), programs)
    os.environ |= {
        "JAX_COMPILATION_CACHE_DIR": programs,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        "JAX_PERSISTENT_CACHE_ENABLE_XLA_CACHES": "none",
    }
    import asammdf  # noqa: F401
    import h5py  # noqa: F401
    import jax  # noqa: F401
    import matplotlib.pyplot  # noqa: F401
    import nptdms  # noqa: F401
    import optimistix  # noqa: F401
    import pyarrow.parquet  # noqa: F401
    import rosbags.highlevel  # noqa: F401
    import scipy.io
    import scipy.optimize
    import scipy.signal  # noqa: F401
    from click import Context

    from vttig_jax.cli.main import VERBS, vttig

    for verb in VERBS:
        vttig.get_command(Context(vttig), verb)


def _remove_as(process: int, folder: str) -> None:
    """Remove a folder in the process that made it, but not in those forked from it."""
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


def call(
    arguments: Sequence[str],
    folder: Path,
    *,
    limit_s: float = NO_END_S,
    before: Callable[[], None] = lambda: None,
) -> Ended:
    """Run `vttig` with these arguments in a folder; `before` is called in the new process."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        began = time.monotonic()
        child = os.fork()
        if child == 0:
            _run(arguments, folder, (out.fileno(), err.fileno()), before)
        status, cpu_s, peak = _wait(child, began + limit_s)
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read())
    code = os.waitstatus_to_exitcode(status)
    return Ended(tuple(arguments), code, texts[0], texts[1], cpu_s, peak)


def _run(
    arguments: Sequence[str], folder: Path, streams: tuple[int, int], before: Callable[[], None]
) -> None:
    """Run the command in the forked process, which never returns from here."""
    code = 70
    try:
        os.chdir(folder)
        for number, stream in enumerate(streams, 1):
            os.dup2(stream, number)
        sys.stdout, sys.stderr = (
            io.TextIOWrapper(os.fdopen(number, "wb", closefd=False), "utf-8") for number in (1, 2)
        )
        warnings.resetwarnings()
        warnings.simplefilter("default")
        from vttig_jax.cli.main import main

        before()
        code = main(list(arguments))
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException as error:  # a defect of the command line itself
        os.write(2, f"Traceback: {error!r}".encode("utf-8", "replace"))
    finally:
        os._exit(code)


def _wait(child: int, until: float) -> tuple[int, float, int]:
    """Wait for a process, and kill it at its limits; return its status, its time and its memory."""
    peak = 0
    while True:
        ended, status, usage = os.wait4(child, os.WNOHANG)
        if ended:
            taken = usage.ru_utime + usage.ru_stime
            return status, taken, max(peak, 1024 * usage.ru_maxrss)
        try:
            pages = Path(f"/proc/{child}/statm").read_text("ascii").split()
            peak = max(peak, _PAGE_BYTES * int(pages[1]))
        except (OSError, IndexError):
            pass
        if time.monotonic() > until or peak > 2 * LIMIT_BYTES:
            os.kill(child, signal.SIGKILL)
        time.sleep(_POLL_S)
