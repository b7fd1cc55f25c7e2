"""The compiled programs that a command keeps: checked one by one, never in the way of a result."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from vttig_jax.cli import program_cache
from vttig_jax.cli.program_cache import VARIABLE, kept_programs, read_programs, write_programs

NAMES = ("jit_a-00-cache", "jit_b-11-cache")


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """Return a folder with two stored programs."""
    stage, store = tmp_path / "stage", tmp_path / "store"
    stage.mkdir()
    store.mkdir()
    for name in NAMES:
        (stage / name).write_bytes(name.encode() * 50)
    (stage / "jit_a-00-atime").write_bytes(b"12345678")
    write_programs(stage, store, set())
    return store


def loaded(store: Path, tmp_path: Path) -> dict[str, bytes]:
    target = tmp_path / f"loaded_{time.time_ns()}"
    target.mkdir()
    known = read_programs(store, target)
    found = {path.name: path.read_bytes() for path in target.iterdir()}
    assert known == set(found)
    return found


def test_a_damaged_program_is_left_out_and_removed(store: Path, tmp_path: Path):
    path = store / NAMES[0]
    whole, other = (store / NAMES[0]).read_bytes(), (store / NAMES[1]).read_bytes()
    assert loaded(store, tmp_path) == {name: name.encode() * 50 for name in NAMES}
    flipped = bytes([*whole[:100], whole[100] ^ 1, *whole[101:]])
    for damaged in (whole[:-7], b"", flipped, other):
        path.write_bytes(damaged)
        assert set(loaded(store, tmp_path)) == {NAMES[1]}
        assert not path.exists()
    path.write_bytes(other)  # two that are exchanged
    (store / NAMES[1]).write_bytes(whole)
    assert loaded(store, tmp_path) == {}


@pytest.mark.parametrize("newest", [0, 1])
def test_the_oldest_programs_beyond_the_limit_are_left_out(
    newest: int, store: Path, tmp_path: Path, monkeypatch, caplog
):
    kept, other = NAMES[newest], NAMES[1 - newest]
    monkeypatch.setattr(program_cache, "_MOST_BYTES", (store / kept).stat().st_size)
    an_hour_ago = time.time() - 3600
    os.utime(store / other, (an_hour_ago, an_hour_ago))
    with caplog.at_level("INFO", logger="vttig_jax"):
        assert set(loaded(store, tmp_path)) == {kept}
    assert not (store / other).exists() and "failed their check" not in caplog.text


@pytest.fixture
def without_jax(monkeypatch, tmp_path: Path):
    """Return the folder of the programs in a process that has not imported JAX."""
    monkeypatch.delitem(sys.modules, "jax")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "programs"))
    return tmp_path / "programs"


def test_new_programs_are_stored_and_old_ones_shown(without_jax: Path) -> None:
    for shown in (set(), {NAMES[0]}):
        with kept_programs("fit"):
            stage = Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
            assert {path.name for path in stage.iterdir()} == shown
            (stage / NAMES[0]).write_bytes(b"program")
        assert "JAX_COMPILATION_CACHE_DIR" not in os.environ and not stage.exists()
    with kept_programs("sweep"):
        assert not list(Path(os.environ["JAX_COMPILATION_CACHE_DIR"]).iterdir())


def test_another_compiler_has_programs_of_its_own(without_jax: Path, monkeypatch) -> None:
    before = program_cache._machine()
    monkeypatch.setattr(program_cache, "version", lambda name: f"{name} of another release")
    assert program_cache._machine() != before


def test_a_full_disk_costs_the_programs_and_nothing_else(without_jax: Path, monkeypatch) -> None:
    def full(*_: object, **__: object):
        raise OSError(28, "No space left on device")

    with kept_programs("fit"):
        stage = Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
        (stage / NAMES[0]).write_bytes(b"program")
        monkeypatch.setattr(program_cache, "replace_file", full)
    assert not stage.exists()


@pytest.mark.parametrize(
    "case", ["off", "OFF", "own cache", "jax", "in the way", "others write", "others write above"]
)
def test_nothing_is_kept(case: str, without_jax: Path, monkeypatch) -> None:
    if case in ("off", "OFF"):
        monkeypatch.setenv(VARIABLE, case)
    elif case == "own cache":
        monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "mine")
    elif case == "jax":
        monkeypatch.setitem(sys.modules, "jax", sys)
    elif case == "in the way":
        without_jax.write_text("a file")
    else:
        folder = without_jax / program_cache._machine() / "fit"
        folder.mkdir(parents=True)
        (folder if case == "others write" else without_jax).chmod(0o777)
    with kept_programs("fit"):
        found = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    assert found == ("mine" if case == "own cache" else None)


TOY = """
import sys
from vttig_jax.cli.main import VERBS, main
from vttig_jax.cli.options import verb

@verb("toy", example="vttig toy")
def command(output):
    '''Add.'''
    import jax
    output.emit({"three": float(jax.jit(lambda x: x + 1.0)(2.0))}, "")

VERBS["toy"] = ("__main__:command", "Add.")
sys.exit(main(["toy", "-v", "--json"]))
"""


def test_a_command_answers_the_same_with_damaged_programs(tmp_path: Path) -> None:
    """Two runs in processes of their own; all programs are damaged between them."""
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment |= {VARIABLE: str(tmp_path), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}

    def run() -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", TOY]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True)

    first = run()
    stored = list(tmp_path.rglob("*-cache"))
    assert stored
    for path in stored:
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 255
        path.write_bytes(bytes(data))
    second = run()
    assert json.loads(second.stdout) == json.loads(first.stdout) == {"three": 3.0}
    assert f"{len(stored)} stored programs failed their check" in second.stderr
    assert "failed" not in first.stderr and "Traceback" not in second.stderr
