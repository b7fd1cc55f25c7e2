import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import pytest

from tests.cli.commands import fit_into, write_paper_pair
from tests.cli.known_error import error_arcsec, fitted, worm_arcsec
from tests.schemas import load_schema
from vttig_jax.cli.main import main
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig


@pytest.fixture(autouse=True, scope="module")
def as_for_a_user(unchecked_module) -> None:
    """Run the commands without checks of annotations."""


def _shared(folder: Path) -> Iterator[Path]:
    """The folder, for all tests of a process; at the end, no test may have written into it."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    yield folder
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


@pytest.fixture(scope="session")
def rig_folder(tmp_path_factory) -> Iterator[Path]:
    """Folder with the pair file of the paper's rig, and a log of eight turns forward and back.

    On fewer turns, most of the time of a fit is the search for the orders that enter.
    """
    folder = tmp_path_factory.mktemp("rig")
    rig = paper_rig(1, PassMotion(speed_rpm=120.0, reversal_deg=2880.0))
    (folder / "log.csv").write_text(log_csv(rig.log(1)))
    write_paper_pair(folder / "pair.toml")
    yield from _shared(folder)


def _fitted(rig_folder: Path, place: Path, *options: str) -> Iterator[Path]:
    log, pair = rig_folder / "log.csv", rig_folder / "pair.toml"
    yield from _shared(fit_into(place / "run", log, pair, *options))


@pytest.fixture(scope="session")
def run_folder(rig_folder, tmp_path_factory) -> Iterator[Path]:
    """Run folder with a fit of the log in `rig_folder`, outside of it: other tests copy that."""
    yield from _fitted(rig_folder, tmp_path_factory.mktemp("fitted"))


@pytest.fixture(scope="session")
def one_flank_folder(rig_folder, tmp_path_factory) -> Iterator[Path]:
    """Run folder with a fit of flank A alone, which determines no constant backlash."""
    yield from _fitted(rig_folder, tmp_path_factory.mktemp("one_flank"), "--flank", "A")


@pytest.fixture(scope="session")
def half_folder(rig_folder, tmp_path_factory) -> Iterator[Path]:
    """A fit of a part of the log in `rig_folder`: the same rig, another noise."""
    yield from _fitted(rig_folder, tmp_path_factory.mktemp("half"), "--cut", "0rev:1rev")


@pytest.fixture(scope="session")
def sampled_folder(run_folder, tmp_path_factory) -> Iterator[Path]:
    """A copy of `run_folder` with draws, too few to converge."""
    out = Path(shutil.copytree(run_folder, tmp_path_factory.mktemp("sampled") / "run"))
    assert main(["sample", "--out", str(out), "--steps", "60", "--no-figures"]) == 5
    yield from _shared(out)


@pytest.fixture(scope="session")
def both(tmp_path_factory) -> Path:
    """Run of a drive 1 : 2 of known error, whose axis repeats after one turn; both flanks."""
    return fitted(tmp_path_factory.mktemp("both") / "drive", error_arcsec, "--delay", "off")


@pytest.fixture(scope="session")
def worm(tmp_path_factory) -> Path:
    """Run of a worm 1 : 40 of known error, in one direction, at one speed."""
    folder = tmp_path_factory.mktemp("worm") / "drive"
    return fitted(folder, worm_arcsec, "--ratio-within", "0", ratio=1 / 40, back=False)


@pytest.fixture
def pair_file(tmp_path):
    """Function that writes a pair file with the given text and returns its path."""

    def write(text, name="pair.toml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def vttig(capsys):
    """Function that runs `vttig` in this process and returns exit code, stdout and stderr."""

    def run(*arguments) -> tuple[int, str, str]:
        capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def told(vttig):
    """Function that runs `vttig`, which has to succeed, and returns stdout."""

    def run(*arguments) -> str:
        code, out, err = vttig(*arguments)
        assert code == 0, err
        return out

    return run


@pytest.fixture
def refused(vttig):
    """Function that checks that a call ends with an exit code, one sentence and no result.

    It returns the sentence, which has to contain some words.
    """

    def check(code: int, words: str, *arguments) -> str:
        found, out, err = vttig(*arguments)
        assert (found, out) == (code, ""), (arguments, out, err)
        assert words in err and err.count("\n") == 1, (arguments, err)
        return err

    return check


@pytest.fixture
def vttig_json(vttig):
    """Function that runs `vttig --json` and returns the exit code and the JSON object on stdout.

    The object is validated with its schema.
    """

    def run(*arguments) -> tuple[int, dict]:
        code, out, _ = vttig(*arguments, "--json")
        record = json.loads(out, parse_constant=_no_json)
        jsonschema.validate(record, load_schema(record["schema"]))
        return code, record

    return run


@pytest.fixture
def found(vttig_json):
    """Function that runs `vttig --json`, which has to succeed, and returns the object."""

    def run(*arguments) -> dict:
        code, record = vttig_json(*arguments)
        assert code == 0, record
        return record

    return run


def _no_json(constant: str):
    raise AssertionError(f"{constant} is no strict JSON")
