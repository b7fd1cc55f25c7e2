"""What a reader has in the working folder before the commands of a page, and shorter commands."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import tomli_w

from tests.cli.drive import write_drive
from tests.control.compensation.linuxcnc import why_not
from tests.guides.pages import REPOSITORY, fences, pages, text_of
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.pair.gear_pair import spec_of
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.rig import PassMotion, paper_rig

NAMED = {
    "docs/pair_file.md": ("pair.toml", "two.toml"),
    "docs/reversals.md": ("scenario.toml", "sweep.toml"),
    "docs/gear.md": ("stated.toml", "measured.csv"),
}
"""Page → names of the files that its TOML and CSV blocks show, in their order."""

SHORTER = {
    "vttig calibrate demo": "vttig calibrate demo --rigs 20",
    "vttig calibrate demo --rigs 1000 --out calibration": (
        "vttig calibrate demo --rigs 20 --out calibration"
    ),
    "python -m benchmarks.calibration --rigs 200": (
        "python -m benchmarks.calibration --rigs 2 --short --case white"
    ),
    "python -m benchmarks.sampler": "python -m benchmarks.sampler --rigs 2",
}
"""Command that takes minutes → the same command for fewer rigs, which runs in its place."""

DRAWN_SHARE = {"docs/reversals.md": 0.05}
"""Page → share by which its numbers may differ, because they are means of random draws."""


def files_of(page: str, folder: Path) -> None:
    """Write the TOML and CSV blocks of a page to the folder by their names."""
    shown = [fence for fence in fences(text_of(page)) if fence.language in ("toml", "csv")]
    for name, fence in zip(NAMED.get(page, ()), shown, strict=True):
        (folder / name).write_text(fence.text, encoding="utf-8")


def with_demo(folder: Path, demo: Path) -> None:
    """Copy the demo, and beside it its log and its pair file."""
    shutil.copytree(demo, folder / "demo")
    for name in ("log.csv", "pair.toml"):
        shutil.copy(demo / name, folder / name)


def with_own_log(folder: Path) -> None:
    """Write a log of a drive that turns 64 times while the driven shaft turns 23 times."""
    write_drive(folder / "log.csv", ratio=23 / 64)


def with_rigs(folder: Path) -> None:
    """Write the logs of three rigs of one design, and their pair file."""
    rig = paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
    (folder / "rigs").mkdir()
    for seed in range(3):
        (folder / "rigs" / f"{seed}.csv").write_text(log_csv(rig.log(seed)))
    (folder / "pair.toml").write_text(tomli_w.dumps(spec_table(spec_of(rig.pair))))


def with_pair(folder: Path) -> None:
    """Write the pair file that the page on pair files shows."""
    shown = next(f for f in fences(text_of("docs/pair_file.md")) if f.language == "toml")
    (folder / "pair.toml").write_text(shown.text, encoding="utf-8")


def with_a_sweep(folder: Path) -> None:
    """Write a sweep of one controller over four reversals, and the pair file."""
    with_pair(folder)
    (folder / "sweep.toml").write_text(
        'pair = "pair.toml"\ncontroller = "acceleration"\n'
        "[eccentricities]\ndriving_mm = 0.0226\ndriving_phase_deg = 49.5\ndriven_mm = 0.0273\n"
        "driven_phase_deg = 79.3\nconstant_backlash_deg = 0.038\n"
        '[sweep]\n"motion.reversal_deg" = { from = 360, to = 720, num = 4 }\n'
    )


def with_fits(folder: Path) -> None:
    """Copy the pair file of the paper."""
    (folder / "fits" / "paper").mkdir(parents=True)
    source = REPOSITORY / "fits" / "paper" / "pair.toml"
    shutil.copy(source, folder / "fits" / "paper" / "pair.toml")


def with_worm(folder: Path) -> None:
    """Write the pair file that the page on pair files shows, and copy the fit of a worm drive."""
    with_pair(folder)
    worm = Path("fits") / "worm_mount" / "cge"
    shutil.copytree(REPOSITORY / worm, folder / worm)


def with_linuxcnc(_: Path) -> None:
    """Skip the page where LinuxCNC cannot run."""
    if reason := why_not():
        pytest.skip(f"LinuxCNC: {reason}")


HAVE: dict[str, Callable[[Path], None]] = {
    "docs/commissioning.md": with_linuxcnc,
    "docs/gear.md": with_fits,
    "docs/logs.md": with_own_log,
    "docs/many_fits.md": with_rigs,
    "docs/reversals.md": with_worm,
    "docs/simulation.md": with_a_sweep,
}
"""Page → what writes the files that its reader has, beside the demo where `DEMO` lists the page."""

DEMO = (
    "README.md",
    "docs/calibration.md",
    "docs/from_log_to_map.md",
    "docs/gear.md",
    "docs/reading_a_report.md",
    "docs/reversals.md",
    "docs/what_a_log_tells.md",
)
"""Pages whose reader has run `vttig demo --out demo`."""


def with_commands() -> list[str]:
    """Return the pages that show commands."""
    return [page for page in pages() if any(f.language == "sh" for f in fences(text_of(page)))]
