"""Sentences of the package name options that exist."""

import importlib
import re
from pathlib import Path

import vttig_jax
from vttig_jax.cli.main import VERBS

PACKAGE = Path(vttig_jax.__file__).parent
EVERYWHERE = {"--help", "--version", "--xla"}  # the last one begins flags of XLA


def options() -> set[str]:
    found = set(EVERYWHERE)
    for target, _ in VERBS.values():
        module, _, name = target.partition(":")
        for parameter in getattr(importlib.import_module(module), name).params:
            if not getattr(parameter, "hidden", False):  # hidden ones are gone, and refused
                found |= {*parameter.opts, *parameter.secondary_opts}
    return found


def named(text: str) -> set[str]:
    return set(re.findall(r"(?<![\w-])--[a-z](?:[a-z0-9-]*[a-z0-9])?", text))


def test_every_option_that_a_sentence_names_exists():
    known = options()
    lacking = {
        str(path.relative_to(PACKAGE)): sorted(unknown)
        for path in PACKAGE.rglob("*.py")
        if (unknown := named(path.read_text("utf-8")) - known)
    }
    assert lacking == {}


def test_an_option_that_is_gone_is_seen():
    assert named("see --drift-order, or --ratio 3:1") - options() == {"--drift-order"}
