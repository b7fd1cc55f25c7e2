import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import pytest
import tomli_w

from tests.schemas import load_schema
from vttig_jax.cli.main import main
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.pair.gear_pair import spec_of
from vttig_jax.pair.pair_file import spec_table
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
    (folder / "pair.toml").write_text(tomli_w.dumps(spec_table(spec_of(rig.pair))))
    yield from _shared(folder)


@pytest.fixture(scope="session")
def run_folder(rig_folder, tmp_path_factory) -> Iterator[Path]:
    """Run folder with a fit of the log in `rig_folder`, outside of it: other tests copy that."""
    out = tmp_path_factory.mktemp("fitted") / "run"
    log, pair = str(rig_folder / "log.csv"), str(rig_folder / "pair.toml")
    assert main(["fit", log, "--pair", pair, "--out", str(out), "--no-figures"]) == 0
    yield from _shared(out)


@pytest.fixture(scope="session")
def one_flank_folder(rig_folder, tmp_path_factory) -> Iterator[Path]:
    """Run folder with a fit of flank A alone, which determines no constant backlash."""
    out = tmp_path_factory.mktemp("one_flank") / "run"
    log, pair = str(rig_folder / "log.csv"), str(rig_folder / "pair.toml")
    arguments = ["fit", log, "--pair", pair, "--out", str(out), "--no-figures"]
    assert main([*arguments, "--flank", "A"]) == 0
    yield from _shared(out)


@pytest.fixture(scope="session")
def sampled_folder(run_folder, tmp_path_factory) -> Iterator[Path]:
    """A copy of `run_folder` with draws, too few to converge."""
    out = Path(shutil.copytree(run_folder, tmp_path_factory.mktemp("sampled") / "run"))
    assert main(["sample", "--out", str(out), "--steps", "60", "--no-figures"]) == 5
    yield from _shared(out)


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
def vttig_json(vttig):
    """Function that runs `vttig --json` and returns the exit code and the JSON object on stdout.

    The object is validated with its schema.
    """

    def run(*arguments) -> tuple[int, dict]:
        code, out, _ = vttig(*arguments, "--json")
        record = json.loads(out, parse_constant=_refuse)
        jsonschema.validate(record, load_schema(record["schema"]))
        return code, record

    return run


def _refuse(constant: str):
    raise AssertionError(f"{constant} is no strict JSON")
