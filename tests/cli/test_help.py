"""Help in groups, and completion by the shell."""

import re
import shlex
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from vttig_jax.cli.main import VERBS, main


def test_every_verb_has_an_example_and_lists_every_option_once(capsys):
    for verb, (place, _) in VERBS.items():
        module, _, name = place.partition(":")
        command = getattr(import_module(module), name)
        assert main([verb, "--help"]) == 0
        out = capsys.readouterr().out
        assert re.search(rf"^ +vttig {verb}\b", out, re.MULTILINE), verb
        titles = (f"\n{title}:" for title in (*command.groups, "Options"))
        listed = out[min(out.index(title) for title in titles if title in out) :].splitlines()
        lines = [line.split()[0].rstrip(",") for line in listed if line.startswith("  -")]
        shown = [one for one in command.params if not getattr(one, "hidden", False)]
        first = [one.opts[0] for one in shown if one.opts[0].startswith("-")]
        assert sorted(lines) == sorted([*first, "-h"]), verb
        names = {one.name for one in command.params}
        assert {name for group in command.groups.values() for name in group} <= names


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_script(capsys, monkeypatch, shell):
    monkeypatch.setenv("_VTTIG_COMPLETE", f"{shell}_source")
    if shell == "bash" and shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    assert main([]) == 0
    script = capsys.readouterr().out
    assert f"_VTTIG_COMPLETE={shell}_complete" in script
    if shell == "bash":
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)


def test_completion_answers(capsys, monkeypatch):
    for words, expected in (
        ("vttig in", "inspect"),
        ("vttig fit --rat", "--ratio"),
        ("vttig fit --unit co", "counts"),
        ("vttig fit --unit time=m", "time=ms"),
    ):
        monkeypatch.setenv("_VTTIG_COMPLETE", "bash_complete")
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
        assert main([]) == 0
        assert expected in capsys.readouterr().out


LOG = "t [s];Motor Winkel [°];load_deg;x;x\n" + "".join(
    f"{k},0;{k},5;{k},1;1;2\n" for k in range(9)
)


@pytest.mark.parametrize(
    ("typed", "found"),
    [
        (["dri"], ["driving=", "driven="]),
        (["ti"], ["time=t [s]", "time=Motor Winkel [°]", "time=load_deg", "time=#4", "time=#5"]),
        (["driven=lo"], ["driven=load_deg"]),
        (["driven=none"], []),
    ],
)
def test_columns_of_the_log_are_completed(tmp_path, capsys, monkeypatch, typed, found):
    log = tmp_path / "a log.csv"
    log.write_text(LOG)
    monkeypatch.setenv("_VTTIG_COMPLETE", "zsh_complete")
    monkeypatch.setenv("COMP_CWORD", "4")
    for verb in ("fit", "inspect", "sample", "fit-many"):
        words = ["vttig", verb, str(log).replace(" ", "\\ "), "--column", *typed]
        monkeypatch.setenv("COMP_WORDS", " ".join(words))
        assert main([]) == 0
        assert capsys.readouterr().out.splitlines()[1::3] == found


@pytest.mark.parametrize("name", ["missing.csv", "empty.csv", "noise.csv"])
def test_a_log_that_cannot_be_read_completes_nothing(tmp_path, capsys, monkeypatch, name):
    (tmp_path / "empty.csv").touch()
    (tmp_path / "noise.csv").write_bytes(bytes(range(256)))
    monkeypatch.setenv("_VTTIG_COMPLETE", "fish_complete")
    monkeypatch.setenv("COMP_WORDS", f"vttig fit {tmp_path / name} --column driving=")
    monkeypatch.setenv("COMP_CWORD", "driving=")
    assert main([]) == 0
    assert capsys.readouterr() == ("\n", "")


DIVIDED = (
    (["--column", "driving", "="], ["t\\ \\[s\\]", "Motor\\ Winkel\\ \\[°\\]"]),
    (
        ["--column", "time", "=", "t", "--column", "driving", "=", "Mo"],
        ["Motor\\ Winkel\\ \\[°\\]"],
    ),
    (["--column", "=", "driven", "=", "lo"], ["load_deg"]),
    (["--ratio", "64", ":", "23", "--unit", "time", "=", "m"], ["ms"]),
)
"""Words before the cursor as Bash divides them, and the first replies."""


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_divides_words_at_equals_signs(tmp_path):
    """Bash gives `driving=Mo` as three words, and replaces only the last by the reply."""
    log = tmp_path / "log.csv"
    log.write_text(LOG)
    vttig = Path(sys.executable).with_name("vttig")
    if not vttig.exists():
        pytest.skip("the command is not installed beside python")
    command = shlex.quote(str(vttig))
    script = f'eval "$(_VTTIG_COMPLETE=bash_source {command})"; compopt() {{ :; }}\n'
    for words, _ in DIVIDED:
        script += (
            f"COMP_WORDS=({shlex.join(['vttig', 'fit', str(log), *words])}); COMPREPLY=()\n"
            "COMP_CWORD=$((${#COMP_WORDS[@]} - 1))\n"
            f"_vttig_completion {command}; printf '%s\\n' \"${{COMPREPLY[@]}}\" --\n"
        )
    found = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    printed = [text.split("\n") for text in found.stdout.split("--\n")[:-1]]
    assert not found.stderr
    for replies, (_, expected) in zip(printed, DIVIDED, strict=True):
        assert replies[: len(expected)] == expected
