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
from vttig_jax.cli.main import GROUPS, VERBS, main
from vttig_jax.cli.options import Argument, verb
from vttig_jax.cli.output import Output

pytestmark = pytest.mark.smoke


def boom(kind: str, out: str) -> None:
    """End a toy command in the way asked for."""
    if kind == "log":
        raise LogError("column `driven` is missing; name it with --column.", where="log.csv")
    if kind == "usage":
        raise UsageError("needs the extra `sample`; pip install vttig-jax[sample].")
    if kind == "answer":
        raise NoAnswerError("the shaft stands still;\nturn it.", where="log.csv: driven")
    if kind == "defect":
        raise KeyError("two\nlines")
    if kind == "disk":
        raise OSError(28, "No space left on device", "x.csv")
    if kind == "memory":
        raise MemoryError
    if kind == "device memory":
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 671 GiB.")
    if kind == "interrupt":
        raise KeyboardInterrupt
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
    """The one JSON object stdout holds; a second one, or a NaN, is an error."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_the_reader_of_one_object_sees_two():
    with pytest.raises(json.JSONDecodeError):
        only_object("{}\n{}\n")


def test_a_result_goes_to_stdout_and_narration_to_stderr(capsys):
    assert main(["toy", "3"]) == 0
    assert capsys.readouterr() == ("twice: 6″\n", "warning: a toy\n")


def test_json_is_one_strict_object(capsys):
    assert main(["toy", "3", "--json"]) == 0
    out = capsys.readouterr().out
    assert out.isascii()
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


def test_a_failure_is_one_sentence_and_one_object(capsys):
    for late in ([], ["--late"]):
        for kind, code, where, message in ENDS:
            sentence = f"error: {where}: {message}\n" if where else f"error: {message}\n"
            assert main(["toy", "3", "-q", "--kind", kind, *late]) == code
            assert capsys.readouterr() == ("twice: 6″\n" if late else "", sentence)
            assert main(["toy", "3", "-q", "--kind", kind, "--json", *late]) == code
            out, err = capsys.readouterr()
            assert err == sentence
            failure = only_object(out)
            jsonschema.validate(failure, load_schema("vttig.error/1"))
            assert failure == {
                "schema": "vttig.error/1",
                "exit": code,
                "message": message,
                "where": where,
            }


def test_a_defect_is_one_sentence_with_the_traceback_in_the_log_file(capsys, tmp_path):
    log = tmp_path / "vttig.log"
    assert main(["toy", "3", "-q", "--kind", "defect"]) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "defect of vttig (KeyError: 'two\\nlines'); run it again with --log-file FILE" in err
    assert main(["toy", "3", "-q", "--kind", "defect", "--json", "--log-file", str(log)]) == 1
    out, err = capsys.readouterr()
    assert f"report the traceback in {log}." in err
    assert "Traceback" not in out + err
    jsonschema.validate(only_object(out), load_schema("vttig.error/1"))
    assert "Traceback (most recent call last)" in log.read_text()
    assert 'raise KeyError("two\\nlines")' in log.read_text()


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


def test_wrong_usage_is_exit_2_with_the_command_to_ask(capsys):
    for arguments, command, seen in USAGES:
        assert main(arguments) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith(f"error: {command}: ")
        assert seen in err
        assert err.endswith(f"`{command} --help`.\n")
        assert err.count("\n") == 1
        assert main([*arguments, "--json"]) == 2
        failure = only_object(capsys.readouterr().out)
        jsonschema.validate(failure, load_schema("vttig.error/1"))
        assert failure["exit"] == 2


def test_json_behind_two_dashes_is_a_name_and_not_the_option(capsys):
    assert main(["toy", "--", "--json"]) == 2
    assert capsys.readouterr().out == ""


def test_verbosity(capsys):
    for options, heard in (
        (["-q"], []),
        ([], ["warning: a toy"]),
        (["-v"], ["doubling 3", "warning: a toy"]),
        (["-vv"], ["details of 3", "doubling 3", "warning: a toy"]),
    ):
        assert main(["toy", "3", *options]) == 0
        assert capsys.readouterr().err.splitlines() == heard


def test_the_log_file_hears_everything_and_is_appended_to(tmp_path):
    log = tmp_path / "vttig.log"
    log.write_text("before\n")
    assert main(["toy", "3", "-q", "--log-file", str(log)]) == 0
    lines = log.read_text().splitlines()
    assert lines[0] == "before"
    assert [line.partition(": ")[2] for line in lines[1:]] == [
        "details of 3",
        "doubling 3",
        "a toy",
    ]


def test_a_log_file_that_cannot_be_written_is_refused(capsys, tmp_path):
    path = tmp_path / "none" / "vttig.log"
    assert main(["toy", "3", "--log-file", str(path)]) == 3
    assert f"error: {path}: the log file cannot be written" in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system")
def test_a_log_file_that_is_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    command = [sys.executable, "-m", "vttig_jax", "measure", "x.toml", "--log-file", "pipe"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 3
    assert done.stderr == "error: pipe: the log file is a pipe and no regular file.\n"


def test_the_logger_is_left_as_it_was(tmp_path):
    before = (LOGGER.level, list(LOGGER.handlers), signal.getsignal(signal.SIGTERM))
    main(["toy", "3", "-v", "--log-file", str(tmp_path / "vttig.log")])
    assert (LOGGER.level, LOGGER.handlers, signal.getsignal(signal.SIGTERM)) == before


def test_sigterm_is_143_and_leaves_nothing_unfinished(capsys, tmp_path):
    out = tmp_path / "run"
    assert main(["toy", "3", "-q", "--kind", "terminate", "--out", str(out)]) == 143
    assert capsys.readouterr().err == "error: terminated before it was done.\n"
    assert list(tmp_path.iterdir()) == []


def test_emit_gives_one_object_only():
    output = Output(json=True)
    output.emit({"a": 1}, "")
    with pytest.raises(RuntimeError, match="`emit` was called twice"):
        output.emit({"a": 2}, "")


def test_text_is_not_made_when_json_is_asked_for(capsys):
    class Unprintable:
        def __str__(self) -> str:
            raise AssertionError

    output = Output(json=True)
    output.emit({"a": 1}, Unprintable())
    assert capsys.readouterr().out == ""
    output.finish()
    assert only_object(capsys.readouterr().out) == {"a": 1}
    with pytest.raises(AssertionError):
        Output(json=False).emit({"a": 1}, Unprintable())


def test_a_verb_works_without_main(capsys):
    toy.main(["4", "-v"], standalone_mode=False)
    assert capsys.readouterr() == ("twice: 8″\n", "doubling 4\nwarning: a toy\n")
    assert LOGGER.handlers == []


def test_help_lists_verbs_and_shows_examples(capsys):
    assert main(["--help"]) == 0
    help_ = capsys.readouterr().out
    for title, verbs in GROUPS.items():
        assert f"{title}:" in help_
        assert all(f"  {name} " in help_ and text in help_ for name, text in verbs.items())
    assert main(["toy", "-h"]) == 0
    help_ = capsys.readouterr().out
    assert "Example:\n    vttig toy 3 --kind log\n    vttig toy 4\n" in help_
    assert all(option in help_ for option in ("--json", "-v", "-q", "--log-file", "--kind"))


def test_a_verb_that_cannot_be_imported_is_a_defect_and_help_still_works(capsys, monkeypatch):
    monkeypatch.setitem(VERBS, "toy", ("vttig_jax.cli.nonesuch_verb:command", "Nothing."))
    assert main(["--help"]) == 0
    assert main(["toy"]) == 1
    assert "ModuleNotFoundError" in capsys.readouterr().err


class Terminal:
    """A stderr that says it is a terminal."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: str) -> int:
        self.text += text
        return len(text)

    def flush(self) -> None:
        pass

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("quiet", [False, True])
def test_progress_shows_on_a_terminal_unless_quiet(monkeypatch, quiet):
    terminal = Terminal()
    monkeypatch.setattr(output_module.sys, "stderr", terminal)
    with Output(quiet=quiet).progress(3, "fitting") as bar:
        bar.update(3)
    assert ("fitting" in terminal.text) != quiet


def test_progress_shows_nothing_off_a_terminal(capsys):
    with Output().progress(3, "fitting") as bar:
        bar.update(3)
    assert capsys.readouterr().err == ""


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
    environment = os.environ | {"PYTHONIOENCODING": "latin-1"}
    code = (
        "import click\nfrom vttig_jax.cli.main import _tolerate_encodings\n"
        "_tolerate_encodings()\nclick.echo('3.77″')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "3.77?\n"


def test_results_that_cannot_be_printed_are_an_input_error(monkeypatch):
    def full(_: str) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(click, "echo", full)
    with pytest.raises(InputError, match="stdout: results cannot be written: No space"):
        output_module.print_text("text")


def test_the_library_itself_is_silent(capsys):
    assert logging.getLogger("vttig_jax").handlers == []
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("vttig ")
