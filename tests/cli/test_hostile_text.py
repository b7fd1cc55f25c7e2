"""Hostile names of pairs, files, columns, keys and options: nothing of them reaches a terminal."""

import csv
import json
import os
import sys
import unicodedata
from pathlib import Path

import pytest
import tomli_w

from tests.cli.drive import write_drive

HOSTILE = (
    "two\nlines\r\nof it",
    "esc\x1b[2J\x1b]0;title\x07",
    "c1\x9b31m del\x7f",
    "\u202egnp.exe\u2066 \u200b",
    "error: \u2028forged line",
    "n" * 100_000,
)
PAIR = {"drive": {"ratio": "1/2"}, "fit": {"driving_orders": [1, 2], "driven_orders": [1, 2]}}


def hidden(text: str) -> list[str]:
    """Characters of a text that show nothing, but the ends of lines."""
    return [c for c in text if c != "\n" and unicodedata.category(c) in ("Cc", "Cf", "Zl", "Zp")]


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_drive(tmp_path / "log.csv")
    (tmp_path / "pair.toml").write_text(tomli_w.dumps(PAIR))
    return tmp_path


def test_the_check_sees_what_is_hidden():
    assert all(hidden(name) or len(name) > 1000 for name in HOSTILE)
    assert hidden("plain, 30° – ″\n") == []


SHORT, LONG = pytest.param(" ".join(HOSTILE[:-1]), id="short"), pytest.param(HOSTILE[-1], id="long")


@pytest.mark.parametrize("name", [SHORT, pytest.param(HOSTILE[-1], marks=pytest.mark.slow)])
def test_names_of_pairs(folder, vttig, name):
    lengths = {}
    for kind, said in (("plain", "rig"), ("hostile", name)):
        (folder / "pair.toml").write_text(tomli_w.dumps({"name": said} | PAIR))
        out = folder / kind
        for call in (
            ("inspect", "log.csv", "--pair", "pair.toml"),
            ("fit", "log.csv", "--pair", "pair.toml", "--out", out, "-v", "--log-file", "log.txt"),
            ("map", out, "--out", f"{kind}.csv"),
            ("export", out, "--out", f"{kind}-export.json", "--constant-backlash-deg", "0.03"),
        ):
            code, text, err = vttig(*call)
            assert code == 0, (call, err)
            assert hidden(text + err) == [] and max(map(len, text.split("\n"))) < 1000
            lengths.setdefault(call[0], []).append(len(text.split("\n")))
        assert json.loads((out / "fit.json").read_text())["pair"] == said
    assert all(plain == hostile for plain, hostile in lengths.values()), lengths
    assert hidden((folder / "log.txt").read_text()) == []


@pytest.mark.parametrize("name", [SHORT, LONG])
def test_names_in_messages(folder, vttig, name):
    (folder / "key.toml").write_text(tomli_w.dumps(PAIR | {name: 1}))
    (folder / "value.toml").write_text(tomli_w.dumps({"log": {"encoding": name}} | PAIR))
    rows = (folder / "log.csv").read_text().splitlines()
    cell = name.replace("\n", " ").replace("\r", " ")
    (folder / "cell.csv").write_text("\n".join([*rows[:9], f"0.3,{cell},1,1,1,1", *rows[9:]]))
    (folder / "head.csv").write_text("\n".join([rows[0].replace("driven_deg", cell), *rows[1:]]))
    pair = ("--pair", "pair.toml")
    for call in (
        ("inspect", name),
        *(("inspect", "log.csv", "--pair", file) for file in (name, "key.toml", "value.toml")),
        *(("inspect", file, *pair) for file in ("cell.csv", "head.csv")),
        ("inspect", "log.csv", "--column", f"driving={name}"),
        ("fit", "log.csv", *pair, "--require", name),
        ("fit", "log.csv", *pair, f"--{name}"),
        ("export", name, "--out", "x.json"),
        ("export", "none", "--out", name),
        *((verb, name) for verb in ("map", "simulate", "sweep", "measure")),
        (name,),
        ("surface", name, "--gear", "driving", "--out", "a.stl"),
        ("sample", "--out", name),
    ):
        code, text, err = vttig(*call)
        assert code in (2, 3), (call, err)
        errors = [line for line in err.split("\n") if line.startswith("error: ")]
        assert hidden(text + err) == [] and len(errors) == 1, (call, err)
        assert len(err) < 1500, call


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="names are UTF-16 or UTF-8")
def test_names_of_files_that_are_no_utf_8(folder, refused, told, found):
    name = os.fsdecode(b"log\xff.csv")
    (folder / "log.csv").rename(folder / name)
    fit = ("fit", name, "--pair", "pair.toml")
    assert found(*fit)["source"].endswith("log\\udcff.csv")
    refused(2, "is no UTF-8 text", *fit, "--out", "run")
    assert not (folder / "run" / "fit.json").exists()
    told("fit-many", name, "--pair", "pair.toml", "--csv", "many.csv", "--out", "m")
    assert "log\\udcff.csv" in (folder / "many.csv").read_text(encoding="utf-8")


def test_names_in_a_table_are_no_formulas(folder, vttig):
    """A spreadsheet computes no cell, and the names that need nothing are as they were."""
    names = {"=1+1.csv": "'=1+1.csv", "+1.csv": "'+1.csv", "@a.csv": "'@a.csv"}
    names |= {"esc\x1b[2J.csv": "esc\\x1b[2J.csv", "a=b.csv": "a=b.csv"}
    for name in names:
        (folder / name).write_bytes((folder / "log.csv").read_bytes() + b"\n" * len(name))
    vttig("fit-many", *names, "--pair", "pair.toml", "--csv", "many.csv")
    rows = list(csv.DictReader((folder / "many.csv").open()))
    assert [row["log"] for row in rows] == list(names.values())
