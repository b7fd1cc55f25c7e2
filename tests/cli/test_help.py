"""Help in groups, completion by the shell, and options that sentences name."""

import re
import shutil
import subprocess
from importlib import import_module
from pathlib import Path

import pytest

import vttig_jax
from vttig_jax.cli.main import VERBS, main

PACKAGE = Path(vttig_jax.__file__).parent


def command_of(verb: str):
    module, _, name = VERBS[verb][0].partition(":")
    return getattr(import_module(module), name)


def test_every_verb_has_an_example_and_lists_every_option_once(capsys):
    for verb in VERBS:
        command = command_of(verb)
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


def test_every_option_that_a_sentence_names_exists():
    known = {"--help", "--version", "--xla"}  # the last one begins flags of XLA
    for parameter in (one for verb in VERBS for one in command_of(verb).params):
        if not getattr(parameter, "hidden", False):  # hidden ones are gone, and refused
            known |= {*parameter.opts, *parameter.secondary_opts}

    def lacking(text: str) -> set[str]:
        return set(re.findall(r"(?<![\w-])--[a-z](?:[a-z0-9-]*[a-z0-9])?", text)) - known

    found = {path: lacking(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")}
    assert {path: options for path, options in found.items() if options} == {}
    assert lacking("see --drift-order, or --ratio 3:1") == {"--drift-order"}
