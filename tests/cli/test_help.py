"""Help in groups, and completion by the shell."""

import shutil
import subprocess

import pytest

from vttig_jax.cli.main import GROUPS, VERBS, main


def test_every_verb_is_in_one_group(capsys):
    listed = [name for names in GROUPS.values() for name in names]
    assert sorted(listed) == sorted(VERBS)
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"{title}:" in out for title in GROUPS)


@pytest.mark.parametrize("verb", ["fit", "inspect", "map"])
def test_every_option_is_listed_once(capsys, verb):
    from importlib import import_module

    command = import_module(f"vttig_jax.cli.verbs.{verb}").command
    assert main([verb, "--help"]) == 0
    out = capsys.readouterr().out
    lines = [line.split()[0].rstrip(",") for line in out.splitlines() if line.startswith("  -")]
    first = [one.opts[0] for one in command.params if one.opts[0].startswith("-")]
    assert sorted(lines) == sorted([*first, "-h"])
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


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("vttig in", "inspect"),
        ("vttig fit --rat", "--ratio"),
        ("vttig fit --unit co", "counts"),
        ("vttig fit --unit time=m", "time=ms"),
    ],
)
def test_completion_answers(capsys, monkeypatch, words, expected):
    monkeypatch.setenv("_VTTIG_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    assert main([]) == 0
    assert expected in capsys.readouterr().out
