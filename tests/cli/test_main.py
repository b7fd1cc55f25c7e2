import io
import json
import logging
import os
import signal
import subprocess
import sys
import types
from pathlib import Path
from typing import Annotated, Any

import click
import jsonschema
import pytest

from tests.schemas import load_schema
from vttig_jax.base.errors import InputError, LogError, NoAnswerError, UsageError
from vttig_jax.base.files.run_folder import RunFolder
from vttig_jax.base.logger import LOGGER
from vttig_jax.cli import output as output_module
from vttig_jax.cli.main import GROUPS, VERBS
from vttig_jax.cli.options import Argument, verb
from vttig_jax.cli.output import Output

pytestmark = pytest.mark.smoke


ERRORS: dict[str, BaseException] = {
    "log": LogError("column `driven` is missing; name it with --column.", where="log.csv"),
    "usage": UsageError("needs the extra `sample`; pip install vttig-jax[sample]."),
    "answer": NoAnswerError("the shaft stands still;\nturn it.", where="log.csv: driven"),
    "defect": KeyError("two\nlines"),
    "disk": OSError(28, "No space left on device", "x.csv"),
    "memory": MemoryError(),
    "device memory": RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 671 GiB."),
    "interrupt": KeyboardInterrupt(),
}


def boom(kind: str, out: str) -> None:
    """End a toy command in the way asked for."""
    if kind in ERRORS:
        raise ERRORS[kind]
    if kind == "terminate":
        with RunFolder(out) as run:
            run.write_text("fit.json", "{}")
            os.kill(os.getpid(), signal.SIGTERM)


@verb("toy", example="vttig toy 3 --kind log\nvttig toy 4")
def toy(
    output: Output,
    *,
    number: Annotated[int, Argument()],
    kind: Annotated[str, "How to fail."] = "",
    late: Annotated[bool, "Fail after the result."],
    out: Annotated[str, "Where."] = "",
) -> None:
    """Double NUMBER."""
    LOGGER.debug("details of %d", number)
    LOGGER.info("doubling %d", number)
    LOGGER.warning("a toy")
    if not late:
        boom(kind, out)
    nan = float("nan")
    output.emit({"schema": "toy/1", "twice": 2 * number, "none": nan}, f"twice: {2 * number}″")
    boom(kind, out)


@pytest.fixture(autouse=True)
def toy_verb(monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("toy_verb")
    module.command = toy  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setitem(sys.modules, "toy_verb", module)
    monkeypatch.setitem(VERBS, "toy", ("toy_verb:command", "Double a number."))


def only_object(text: str) -> Any:
    """The one JSON object that stdout holds; a second one is an error.

    NaN is one too, and so is an object of a failure that breaks its schema.
    """

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    found = json.loads(text, parse_constant=refuse)
    if "exit" in found:
        jsonschema.validate(found, load_schema("vttig.error/1"))
    return found


def test_a_result_goes_to_stdout_and_narration_to_stderr(vttig):
    with pytest.raises(json.JSONDecodeError):
        only_object("{}\n{}\n")
    assert vttig("toy", 3) == (0, "twice: 6″\n", "warning: a toy\n")
    code, out, _ = vttig("toy", 3, "--json")
    assert code == 0 and out.isascii()
    assert only_object(out) == {"schema": "toy/1", "twice": 6, "none": None}


NO_MEMORY = (
    "there is not enough memory for this; close other programs, or ask for less (a shorter log,"
    " fewer orders or cases)."
)
ENDS = [
    ("log", 3, "log.csv", "column `driven` is missing; name it with --column."),
    ("usage", 2, "", "needs the extra `sample`; pip install vttig-jax[sample]."),
    ("answer", 4, "log.csv: driven", "the shaft stands still; turn it."),
    ("disk", 3, "x.csv", "No space left on device."),
    ("memory", 3, "", NO_MEMORY),
    ("device memory", 3, "", NO_MEMORY),
    ("interrupt", 130, "", "interrupted before it was done."),
]


@pytest.mark.parametrize("late", [(), ("--late",)])
def test_a_failure_is_one_sentence_and_one_object(vttig, late):
    for kind, code, where, message in ENDS:
        call = ("toy", 3, "-q", "--kind", kind, *late)
        sentence = f"error: {where}: {message}\n" if where else f"error: {message}\n"
        assert vttig(*call) == (code, "twice: 6″\n" if late else "", sentence)
        found, out, err = vttig(*call, "--json")
        assert (found, err) == (code, sentence)
        failure = {"schema": "vttig.error/1", "exit": code, "message": message, "where": where}
        assert only_object(out) == failure


def test_a_defect_is_one_sentence_with_the_traceback_in_the_log_file(vttig, refused, tmp_path):
    log, call = tmp_path / "vttig.log", ("toy", 3, "-q", "--kind", "defect")
    said = refused(1, "defect of vttig (KeyError: 'two\\nlines')", *call)
    assert "run it again with --log-file FILE" in said
    code, out, err = vttig(*call, "--json", "--log-file", log)
    assert code == 1 and f"report the traceback in {log}." in err
    assert only_object(out)["exit"] == 1 and "Traceback" not in out + err
    assert "Traceback (most recent call last)" in log.read_text()
    assert "raise ERRORS[kind]" in log.read_text()


USAGES = [
    (["toy"], "vttig toy", "Missing argument 'NUMBER'"),
    (["toy", "x"], "vttig toy", "'x' is not a valid integer"),
    (["toy", "3", "--nonesuch"], "vttig toy", "--nonesuch"),
    (["toy", "3", "-v", "-q"], "vttig toy", "Options -v and -q exclude each other"),
    (["nonesuch"], "vttig", "No such command 'nonesuch'"),
    ([], "vttig", "a command is missing"),
    (["-v"], "vttig", "-v is no option here: options follow the command"),
    (["-q", "toy", "3"], "vttig", "-q is no option here: options follow the command"),
]


def test_wrong_usage_is_exit_2_with_the_command_to_ask(vttig, refused):
    for arguments, command, seen in USAGES:
        err = refused(2, seen, *arguments)
        assert err.startswith(f"error: {command}: ") and err.endswith(f"`{command} --help`.\n")
        code, out, _ = vttig(*arguments, "--json")
        assert code == only_object(out)["exit"] == 2
    refused(2, "", "toy", "--", "--json")  # behind two dashes it is a name


def test_verbosity_and_the_log_file_that_hears_everything(vttig, refused, tmp_path):
    log = tmp_path / "vttig.log"
    log.write_text("before\n")
    before = (LOGGER.level, list(LOGGER.handlers), signal.getsignal(signal.SIGTERM))
    heard = ["details of 3", "doubling 3", "warning: a toy"]
    for option, first in (("-q", 3), ("--late", 2), ("-v", 1), ("-vv", 0)):
        assert vttig("toy", 3, option)[2].splitlines() == heard[first:]
    assert vttig("toy", 3, "-v", "--log-file", log)[0] == 0
    lines = [line.partition(": ")[2] or line for line in log.read_text().splitlines()]
    assert lines == ["before", "details of 3", "doubling 3", "a toy"]
    assert (LOGGER.level, LOGGER.handlers, signal.getsignal(signal.SIGTERM)) == before
    nowhere = tmp_path / "none" / "vttig.log"
    refused(3, f"{nowhere}: the log file cannot be written", "toy", 3, "--log-file", nowhere)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system")
def test_a_log_file_that_is_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    command = [sys.executable, "-m", "vttig_jax", "measure", "x.toml", "--log-file", "pipe"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 3
    assert done.stderr == "error: pipe: the log file is a pipe and no regular file.\n"


def test_sigterm_is_143_and_leaves_nothing_unfinished(vttig, tmp_path):
    call = ("toy", 3, "-q", "--kind", "terminate", "--out", tmp_path / "run")
    assert vttig(*call) == (143, "", "error: terminated before it was done.\n")
    assert list(tmp_path.iterdir()) == []


def test_text_is_not_made_when_json_is_asked_for(capsys):
    class Unprintable:
        def __str__(self) -> str:
            raise AssertionError

    output = Output(json=True)
    output.emit({"a": 1}, Unprintable())
    with pytest.raises(RuntimeError, match="`emit` was called twice"):
        output.emit({"a": 2}, "")
    assert capsys.readouterr().out == ""
    output.finish()
    assert only_object(capsys.readouterr().out) == {"a": 1}
    with pytest.raises(AssertionError):
        Output(json=False).emit({"a": 1}, Unprintable())


def test_a_verb_works_without_main(capsys):
    toy.main(["4", "-v"], standalone_mode=False)
    assert capsys.readouterr() == ("twice: 8″\n", "doubling 4\nwarning: a toy\n")
    assert LOGGER.handlers == []


def test_help_lists_verbs_and_shows_examples(vttig, told, monkeypatch):
    out = told("--help")
    for title, verbs in GROUPS.items():
        assert f"{title}:" in out
        assert all(f"  {name} " in out and text in out for name, text in verbs.items())
    out = told("toy", "-h")
    assert "Example:\n    vttig toy 3 --kind log\n    vttig toy 4\n" in out
    assert all(option in out for option in ("--json", "-v", "-q", "--log-file", "--kind"))
    # A verb that cannot be imported is a defect, and help still works.
    monkeypatch.setitem(VERBS, "toy", ("vttig_jax.cli.nonesuch_verb:command", "Nothing."))
    told("--help")
    code, _, err = vttig("toy")
    assert code == 1 and "ModuleNotFoundError" in err


class Terminal(io.StringIO):
    """A stderr that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_progress_shows_on_a_terminal_unless_quiet(monkeypatch):
    for stream, quiet in ((Terminal(), False), (Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(output_module.sys, "stderr", stream)
        with Output(quiet=quiet).progress(3, "fitting") as bar:
            bar.update(3)
        assert ("fitting" in stream.getvalue()) is (stream.isatty() and not quiet)


def run_help(**options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "vttig_jax", "--help"]
    return subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False, **options)


def test_a_reader_that_left_is_no_error():
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = run_help(stdout=writing)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_behind_stdout_is_exit_3(unbuffered, monkeypatch):
    """Also where the interpreter writes only when it ends."""
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    with open("/dev/full", "w") as full:
        done = run_help(stdout=full)
    assert done.returncode == 3
    assert done.stderr.splitlines() == ["error: No space left on device."]


def test_a_terminal_without_greek_gets_a_mark():
    code = (
        "import click\nfrom vttig_jax.cli.main import _tolerate_encodings\n"
        "_tolerate_encodings()\nclick.echo('3.77″')"
    )
    environment = os.environ | {"PYTHONIOENCODING": "latin-1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, check=True
    )
    assert done.stdout == b"3.77?\n"


def test_results_that_cannot_be_printed_are_an_input_error(monkeypatch):
    def full(_: str) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(click, "echo", full)
    with pytest.raises(InputError, match="stdout: results cannot be written: No space"):
        output_module.print_text("text")


def test_the_library_itself_is_silent(told):
    assert logging.getLogger("vttig_jax").handlers == []
    assert told("--version").startswith("vttig ")
