"""The worked identifications: their numbers, and that their READMEs say what the commands print."""

import importlib.util
import json
import re
import shlex
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import vttig_jax
from tests.guides.printed import differences as printed_differently
from vttig_jax.cli.main import main

REPOSITORY = Path(__file__).resolve().parents[1]
FITS = REPOSITORY / "fits"
WORM = FITS / "worm_mount"


def script(name: str) -> ModuleType:
    """A script of `fits/`, such as "paper/compare"."""
    spec = importlib.util.spec_from_file_location(Path(name).name, FITS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str((FITS / name).parent))
        spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def compare() -> ModuleType:
    return script("paper/compare")


@pytest.mark.parametrize("relation", ["closed, α", "closed, α_w", "exact"])
def test_te_of_table_2(compare: ModuleType, relation: str):
    flanks = compare.flank_statistics()
    forward, backward = flanks["A", relation], flanks["B", relation]
    for name, value in {"min": -0.0719, "max": 0.0040, "mean": -0.0340}.items():
        assert forward[name] == pytest.approx(value, abs=1e-4)
    assert forward["range"] == pytest.approx(forward["max"] - forward["min"], abs=1e-12)
    assert backward["range"] == pytest.approx(0.0758, abs=1e-4)
    assert max(forward["range"], backward["range"]) < compare.range_bound()


def test_table_3_is_out_of_reach(compare: ModuleType):
    assert compare.range_bound() == pytest.approx(0.0761, abs=5e-5)
    printed = [
        values
        for run in compare.PRINTED["table_3"]
        for control in ("with_control", "without_control")
        for values in run[control].values()
    ]
    spans = sorted(high - low for _, high, low in printed)
    # The first is the row without its minus sign.
    assert (*spans[:2], spans[-1]) == pytest.approx((0.0957, 0.1253, 0.1594), abs=1e-9)
    runs = [compare.run_statistics(angle) for angle in (1080, 3600, 7560)]
    assert max(run["A and B"]["range"] for run in runs) == pytest.approx(0.1139, abs=1e-4)
    assert runs[-1]["A"]["mean"] == pytest.approx(-0.0342, abs=5e-5)
    assert runs[-1]["A and B"]["mean"] == pytest.approx(-0.0152, abs=5e-5)
    means = [mean for mean, _, _ in printed]
    assert (min(means), max(means)) == (0.0331, 0.0437)


def test_backlash_at_the_reversals(compare: ModuleType):
    expected = {1080: 0.0043, 3600: 0.0004, 7560: 0.0063, 7524: 0.0026}
    for angle, value in expected.items():
        for relation, found in compare.variable_backlash(angle).items():
            assert found == pytest.approx(value, abs=6e-5), (angle, relation)
    closed = compare.variable_backlash(7560)
    assert closed["closed, α"] != pytest.approx(closed["closed, α_w"], abs=1e-5)


def test_span_between_1080_and_3600(compare: ModuleType):
    for relation in compare.RELATIONS:
        assert compare.explained_span(relation) == pytest.approx(0.0056, abs=6e-5)
    # By hand: 2 K sin α e₂ |cos χ − cos(χ + 337.5°)| is largest at 2 sin 11.25°.
    largest = 2 * np.sin(np.radians(20)) * 0.0273 * 2 * np.sin(np.radians(11.25))
    largest /= 80 * np.cos(np.radians(20))
    assert compare.explained_span("closed, α") == pytest.approx(np.degrees(largest), rel=1e-4)
    assert compare.printed_span("experiment") == pytest.approx(0.0129, abs=1e-12)
    assert compare.printed_span("simulation") == pytest.approx(0.0181, abs=1e-12)


def test_relations_differ_by_less_than_the_readme_says(compare: ModuleType):
    angle = compare.way(5760)
    largest = []
    for flank in ("A", "B"):
        exact = compare.te("exact", angle, flank)
        for relation in ("closed, α", "closed, α_w"):
            largest.append(np.abs(compare.te(relation, angle, flank) - exact).max())
    gaps = {
        name: compare.te(name, angle, "B", "absolute") - compare.te(name, angle, "A", "absolute")
        for name in compare.RELATIONS
    }
    largest += [np.abs(gap - gaps["exact"]).max() for gap in gaps.values()]
    assert 0.0001 < np.degrees(max(largest)) < 0.0003


def test_dimensions_of_table_1(compare: ModuleType):
    rows = {name: (value, printed) for name, value, printed in compare.dimensions()}
    for name, value, printed in (
        ("tooth thickness, thick end", 4.1897, 4.195),
        ("tooth thickness, thin end", 2.0934, 2.093),
        ("tip diameter, driving", 94, 94),
        ("tip diameter, driven", 164, 164),
        ("root diameter, driving", 85, 85),
        ("root diameter, driven", 155, 155),
        ("transmission ratio 1/i", 16 / 9, 1.778),
    ):
        least = 5e-5 if name.startswith("tooth") else None  # those are known to four decimals
        assert rows[name] == (pytest.approx(value, abs=least), printed)


@pytest.mark.parametrize(
    ("name", "number"), [("paper/compare", "0.0761"), ("paper/driving_degrees", "0.1352")]
)
def test_paper_readme_shows_what_the_script_prints(
    name: str,
    number: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    """With `--write` a script renews its part of the README, and its pictures."""
    module, readme = script(name), tmp_path / "README.md"
    shown = (FITS / "paper" / "README.md").read_text(encoding="utf-8")
    module.main([])
    shown = shown.split(module.BEGIN)[1].split(module.END)[0]
    assert shown.strip() == capsys.readouterr().out.strip()
    monkeypatch.setattr(module, "HERE", tmp_path)
    readme.write_text(f"before\n{module.BEGIN}old\n{module.END}after\n", encoding="utf-8")
    module.main(["--write"])
    text = readme.read_text(encoding="utf-8")
    assert text.startswith("before\n") and text.endswith("after\n")
    assert "old" not in text and number in text
    pictures = {path.name: path.read_bytes() for path in tmp_path.glob("*.png")}
    drawn = {"transmission_error.png", "backlash_map.png"} if name == "paper/compare" else set()
    assert set(pictures) == drawn
    assert all(picture.startswith(b"\x89PNG") for picture in pictures.values())
    assert all((FITS / "paper" / picture).is_file() for picture in drawn)


MEASURED = ("kuka_kr300", "worm_mount", "as5047")
"""Folders whose READMEs show what commands make of logs that are not kept here."""

BLOCKS = re.compile(
    r"(?ms)^```python\n(.*?)^```\n|^    ((?:vttig|python) .*?)\n|^```text\n(.*?)^```\n"
)


def shown_runs(readme: str) -> list[tuple[str, str, str]]:
    """What a README shows: (kind, source, printed); kind is "python" for code, else "command"."""
    found, before = [], None
    for match in BLOCKS.finditer(readme):
        code, command, printed = match.groups()
        if printed is None:
            before = ("python", code) if code is not None else ("command", command)
        else:
            assert before is not None, "a text block without the command that prints it"
            found.append((*before, printed.strip()))
            before = None
    return found


def shown(kind: str) -> list[Any]:
    """Runs of one kind in the READMEs, as parameters of a test."""
    return [
        pytest.param(source, printed, id=f"{rig}-{number}")
        for rig in MEASURED
        for number, (found, source, printed) in enumerate(
            shown_runs((FITS / rig / "README.md").read_text(encoding="utf-8"))
        )
        if found == kind and not source.startswith("python")
    ]


@pytest.fixture
def in_repository(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder of the READMEs' commands, where the logs are on this machine."""
    assert data_dir == REPOSITORY.parent / "shared" / "data"
    monkeypatch.chdir(REPOSITORY)
    return REPOSITORY


@pytest.mark.portable
@pytest.mark.parametrize(("command", "printed"), shown("command"))
def test_readme_shows_what_the_command_prints(
    command: str,
    printed: str,
    in_repository: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    """Up to the last digits; and the run folder that is kept holds the same answer."""
    program, *arguments = shlex.split(command)
    kept = None
    if "--out" in arguments:
        place = arguments.index("--out") + 1
        kept = in_repository / arguments[place]
        arguments[place] = str(tmp_path / "run")
        arguments.append("--no-figures")
    assert program == "vttig" and main(arguments) == 0
    assert printed_differently(printed, capsys.readouterr().out.strip(), 0.005) == []
    if kept is not None:
        one, other = (
            json.loads((place / "fit.json").read_text(encoding="utf-8"))["parameters"]
            for place in (kept, tmp_path / "run")
        )
        assert set(one) == set(other)
        for name, number in one.items():
            again = other[name]
            assert number["determined"] == again["determined"], name
            if number["value"] is not None:
                # The search for the noise ends a hundredth of its standard error before its top.
                assert abs(number["value"] - again["value"]) <= 0.05 * number["std"], name
                assert again["std"] == pytest.approx(number["std"], rel=0.02), name


@pytest.mark.parametrize(("code", "printed"), shown("python"))
def test_readme_shows_what_the_code_prints(
    code: str, printed: str, in_repository: Path, capsys: pytest.CaptureFixture[str]
):
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out.strip() == printed


def test_shown_runs_are_found():
    readme = (
        "a\n\n    vttig fit x\n\n```text\n1\n```\n\n```python\nprint(2)\n```\n\n```text\n2\n```\n"
    )
    assert shown_runs(readme) == [("command", "vttig fit x", "1"), ("python", "print(2)\n", "2")]
    with pytest.raises(AssertionError, match="without the command"):
        shown_runs("```text\n1\n```\n")
    assert len(shown("command")) == 7 and len(shown("python")) == 2


@pytest.mark.parametrize("rig", [*MEASURED, "paper"])
def test_readme_shows_the_pictures_that_are_kept(rig: str):
    readme = (FITS / rig / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"!\[[^]]+\]\(([^)]+\.png)\)", readme))
    kept = {path.relative_to(FITS / rig).as_posix() for path in (FITS / rig).rglob("*.png")}
    assert named == kept and named
    most = 1_500_000 if rig == "paper" else 1_200_000
    assert sum(path.stat().st_size for path in (FITS / rig).rglob("*.png")) < most


def kept_files() -> list[Path]:
    """Files under `fits/` that git keeps or would keep."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "fits"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode != 0:
        pytest.skip("this is no git checkout")
    return [REPOSITORY / name for name in listed.stdout.splitlines()]


def test_no_measured_data_and_no_absolute_path_is_kept():
    files = kept_files()
    assert WORM / "ap_gt1100" / "fit.json" in files
    assert {path.suffix for path in files} <= {".md", ".py", ".toml", ".json", ".png", ""}
    for path in files:
        if path.suffix in {".md", ".toml", ".json"}:
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"[\"\s=]/(work|home|tmp|Users|root)\b|[A-Z]:\\", text), path


def test_worm_pair_file():
    pair = vttig_jax.load_pair(WORM / "pair.toml")
    assert isinstance(pair, vttig_jax.Drive)
    assert float(pair.ratio) == 1 / 225 and pair.log.zero == "reading"
