"""The command `vttig`: calls a verb, and reports every failure by an exit code and one sentence.

Exit codes: 0 success, 1 defect of vttig, 2 usage, 3 input, 4 no trustworthy answer, 5 sampler not
converged, 130 interrupted, 143 terminated. The import of this module imports neither numpy nor jax;
the module of a verb is imported when the verb is called.
"""

import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import takewhile

import click

from ..base.errors import InputError, VttigError
from ..base.logger import LOGGER
from .output import Narrator, library_messages_in_log, print_json

GROUPS = {
    "From a log": {
        "inspect": "Say what a log holds and what is wrong with it.",
        "fit": "Identify eccentricities and backlash from a log.",
        "fit-many": "Identify many logs, each of a rig of its own, in one table.",
        "map": "Write the backlash at every angle from a fit.",
        "sample": "Sample the posterior of a fit, with checkpoints.",
        "locate": "Find the turn in the hunting period from two readings.",
        "export": "Write the compensation as CSV, JSON or a C header.",
        "verify": "Say by a log of an axis whether its error table works.",
    },
    "To hand over": {
        "report": "Write a run as a page to read, send and print.",
        "accuracy": "Say how accurate a drive is, in the terms of standards.",
        "plot": "Draw one picture of a run as PNG, SVG or PDF.",
        "compare": "Say which differences between two runs count.",
        "explain": "Say what a word or a parameter of a report means.",
    },
    "Plan and simulate": {
        "plan": "Say how well a run would tell every parameter.",
        "calibrate": "Check on simulated rigs that stated uncertainties hold.",
        "simulate": "Simulate a reversal with an anti-backlash controller.",
        "sweep": "Simulate thousands of cases: axes, controllers, drawn rigs.",
        "tune": "Tune the settings of a controller over all cases of a sweep.",
        "demo": "Simulate the paper's rig, fit it and show the result.",
    },
    "The gear": {
        "measure": "Say what a shop measures on the gears of a pair.",
        "surface": "Write a gear as a mesh, a CAD solid or a section.",
        "contact": "Find where the teeth of a pair touch, from their surfaces.",
    },
}
"""Title in the help → verb → short help."""

VERBS = {
    verb: (f"vttig_jax.cli.verbs.{verb.replace('-', '_')}:command", text)
    for verbs in GROUPS.values()
    for verb, text in verbs.items()
}
"""Verb → ("module:command", short help)."""

_NO_MEMORY = (
    "there is not enough memory for this; close other programs, or ask for less (a shorter log,"
    " fewer orders or cases)."
)
_OBJECTS = 50_000  # new objects after which Python searches for unused cycles; chosen value

COMPLETION = "_VTTIG_COMPLETE"
"""Environment variable by which a shell requests the completion of a command line."""


class _Terminated(BaseException):
    """Exception raised on SIGTERM, so that unfinished files are removed before the process ends."""


class _LazyGroup(click.Group):
    """Group that lists the names and the short help of its verbs without importing them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        module, _, attribute = VERBS[cmd_name][0].partition(":")
        return getattr(import_module(module), attribute)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, verbs in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl(list(verbs.items()))


@click.group(
    cls=_LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="`vttig COMMAND --help` shows the options of a command and an example. Compiled"
    " programs are kept in the user's cache folder for the next run; the environment variable"
    " VTTIG_CACHE names another folder, and VTTIG_CACHE=off keeps none."
    '\n\nCompletion: put `eval "$(_VTTIG_COMPLETE=bash_source vttig)"` into ~/.bashrc, the same'
    " with zsh_source into ~/.zshrc, or `_VTTIG_COMPLETE=fish_source vttig | source` into"
    " ~/.config/fish/config.fish.",
)
@click.version_option(package_name="vttig-jax", message="%(prog)s %(version)s")
def vttig() -> None:
    """Transmission error and backlash of gear pairs, from the logs of two encoders."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `vttig` with `argv`, by default the arguments of the process; return the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    # The matrices are small, so pools of threads take more time than they save.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Angles of thousands of degrees have no arcseconds in float32.
    os.environ["JAX_ENABLE_X64"] = "1"
    if "jax" in sys.modules:  # it has read the variable already
        sys.modules["jax"].config.update("jax_enable_x64", True)
    _tolerate_encodings()
    if instruction := os.environ.get(COMPLETION):
        from click.shell_completion import shell_complete

        return shell_complete(vttig, {}, "vttig", COMPLETION, instruction)
    # Imports make many objects and no cycles; with the threshold of Python, 700 new objects, the
    # search for unused cycles takes an eighth of their time.
    gc.set_threshold(_OBJECTS, *gc.get_threshold()[1:])
    with Narrator() as narrator, library_messages_in_log(), _sigterm_raises():
        try:
            code = _invoke(arguments, narrator)
            sys.stdout.flush()
            return code
        except BrokenPipeError:
            # The reader of stdout closed the pipe (`vttig … | head`); this is no failure.
            _silence_stdout()
            return 0
        except BaseException as error:
            code = _report(error, narrator, "--json" in takewhile("--".__ne__, arguments))
            try:
                sys.stdout.flush()
            except OSError:  # what cannot be written would fail again when the interpreter ends
                _silence_stdout()
            return code


def _invoke(arguments: list[str], narrator: Narrator) -> int:
    # `Group.main` is not used, because it handles Ctrl-C and closed pipes in its own way.
    try:
        # click removes the arguments that it parses, so it gets a copy.
        with vttig.make_context("vttig", list(arguments), obj=narrator) as context:
            vttig.invoke(context)
    except click.exceptions.Exit as ended:
        return ended.exit_code
    return 0


def _explain(error: BaseException, narrator: Narrator) -> tuple[int, str, str]:
    """Return the exit code, the sentence, and the place (file or command) of an error."""
    if isinstance(error, VttigError):
        return error.exit_code, error.message, error.where
    if isinstance(error, click.ClickException):
        return _explain_usage(error)
    if isinstance(error, KeyboardInterrupt):
        return 130, str(error) or "interrupted before it was done.", ""
    if isinstance(error, _Terminated):
        return 143, str(error) or "terminated before it was done.", ""
    if isinstance(error, OSError) and error.strerror:
        return InputError.exit_code, f"{error.strerror}.", str(error.filename or "")
    if isinstance(error, MemoryError) or str(error).startswith("RESOURCE_EXHAUSTED"):  # also of jax
        return InputError.exit_code, _NO_MEMORY, ""
    if narrator.log_file is None:
        cure = "run it again with --log-file FILE and report the traceback in that file"
    else:
        cure = f"report the traceback in {narrator.log_file}"
    seen = " ".join(f"{type(error).__name__}: {error}".split())
    return 1, f"this is a defect of vttig ({seen}); {cure}.", ""


def _explain_usage(error: click.ClickException) -> tuple[int, str, str]:
    context = error.ctx if isinstance(error, click.UsageError) else None
    command = context.command_path if context else "vttig"
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        sentence = "a command is missing"
    elif isinstance(error, click.NoSuchOption) and command == "vttig":
        # click stops at options before the command, such as `vttig -v fit log.csv`
        sentence = (
            f"{error.option_name} is no option here: options follow the command, as in"
            " `vttig fit log.csv -v`; `vttig --version` prints the version"
        )
    else:
        sentence = " ".join(error.format_message().split()).rstrip(".")
    joint = " See" if sentence.endswith("?") else "; see"
    return 2, f"{sentence}{joint} `{command} --help`.", command


def _report(error: BaseException, narrator: Narrator, as_json: bool) -> int:
    """Log an error, print its object if `as_json`, and return its exit code."""
    code, message, where = _explain(error, narrator)
    # The message is one line even if a quoted text has several.
    message = " ".join(message.split())
    defect = None if isinstance(error, (VttigError, click.ClickException)) else error
    LOGGER.error("%s", f"{where}: {message}" if where else message, exc_info=defect)
    if as_json:
        failure = {"schema": "vttig.error/1", "exit": code, "message": message, "where": where}
        with suppress(OSError, VttigError):  # the error may be that stdout cannot be written
            print_json(failure)
    return code


def _tolerate_encodings() -> None:
    """Print a question mark for a character that the terminal cannot show, such as ″ or φ."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")


def _silence_stdout() -> None:
    """Redirect stdout to the null device, so that the last flush of the interpreter succeeds."""
    with suppress(OSError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)


@contextmanager
def _sigterm_raises() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers
        return

    def handler(*_: object) -> None:
        raise _Terminated

    previous = signal.signal(signal.SIGTERM, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
