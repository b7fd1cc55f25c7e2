"""The page of `vttig report` in a browser: drawn, read out, narrow, dark, and printed."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import tomli_w

from tests.cli.browser import PROGRAM, Page
from tests.cli.drive import write_drive
from vttig_jax.cli.main import main

pytestmark = pytest.mark.skipif(
    PROGRAM is None, reason="Chromium is not installed (packages chromium and fonts-dejavu)"
)

NAME = "<script>alert(1)</script>"
DRAWN = "document.documentElement.dataset.drawn == 'yes'"
EVERYWHERE = """(selector => { const found = []; (function walk(node) {
  for (const one of node.querySelectorAll('*')) {
    if (one.matches(selector)) found.push(one);
    if (one.shadowRoot) walk(one.shadowRoot);
  }})(document); return found; })"""
"""JavaScript: all elements of a selector, also those in shadow trees."""


@pytest.fixture(scope="module")
def report(sampled_folder, tmp_path_factory) -> Path:
    """A page of a run with draws."""
    out = tmp_path_factory.mktemp("report") / "report.html"
    assert main(["report", str(sampled_folder), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def page(report, tmp_path_factory) -> Iterator[Page]:
    with Page(tmp_path_factory.mktemp("profile")) as opened:
        opened.emulate(1100)
        opened.open(report, DRAWN)
        yield opened


def said(page: Page) -> list[str]:
    """What the page has written to the console, and the exceptions of its programs."""
    kinds = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
    return [str(event) for event in page.events if event["method"] in kinds]


def requests(page: Page) -> list[str]:
    """Addresses that the page has asked for."""
    sent = [one for one in page.events if one["method"] == "Network.requestWillBeSent"]
    return [one["params"]["request"]["url"] for one in sent]


def test_the_charts_are_drawn_without_a_word_or_a_request(page, report):
    charts = page.run("document.querySelectorAll('.chart').length")
    drawn = page.run(
        f"[...document.querySelectorAll('.chart')].filter(c => {EVERYWHERE}('svg path').length)"
        ".length && [...document.querySelectorAll('.chart')].map(c => c.clientHeight)"
    )
    assert charts >= 7 and len(drawn) == charts and min(drawn) >= 300
    lines = page.run(f"{EVERYWHERE}('svg path[stroke=\"#3f90da\"]').length")
    assert lines >= charts - 2  # the orders are bars
    assert page.run(f"{EVERYWHERE}('canvas').length") <= charts  # drawn as vectors
    assert said(page) == []
    asked = requests(page)
    assert asked[0] == report.as_uri() and all(one.startswith("data:") for one in asked[1:])


def test_a_word_on_the_console_is_heard(page):
    page.run("console.log('heard')")
    assert any("heard" in one for one in said(page))
    page.events.clear()


def test_a_reading_under_the_pointer(page):
    page.run("document.getElementById('backlash-0-0').scrollIntoView({block: 'center'})")
    box = page.run(
        "(b => [b.left, b.top, b.width, b.height])"
        "(document.getElementById('backlash-0-0').getBoundingClientRect())"
    )
    for x in (0.5, 0.505):
        place = {"x": box[0] + x * box[2], "y": box[1] + 0.5 * box[3]}
        page("Input.dispatchMouseEvent", type="mouseMoved", **place)
    shown = ""
    for _ in range(40):
        shown = page.run(f"{EVERYWHERE}('.bk-tooltip-content').map(e => e.innerText).join(' ')")
        shown = shown or page.run(
            f"{EVERYWHERE}('.bk-Tooltip').map(e => [...e.shadowRoot"
            ".querySelectorAll('div')].map(d => d.innerText)).join(' ')"
        )
        if re.search(r"\d\.\d{3}", shown):
            break
    assert "gap, angle of the driven shaft" in shown and "mm axial" in shown, shown
    assert re.search(r"\d\.\d{3}", shown)


def test_a_telephone_sees_all_of_it(page):
    page.emulate(390)
    try:
        assert page.run("document.documentElement.scrollWidth") <= 390
    finally:
        page.emulate(1100)


@pytest.mark.slow
def test_tables_of_two_runs_are_not_cut_off(sampled_folder, run_folder, tmp_path):
    out = tmp_path / "two.html"
    assert main(["report", str(sampled_folder), str(run_folder), "--out", str(out)]) == 0
    with Page(tmp_path / "profile") as page:
        page.emulate(1100)
        page.open(out, DRAWN)
        widths = page.run(
            "[...document.querySelectorAll('section > .parts .wide, section > .wide')]"
            ".filter(one => one.clientWidth).map(one => one.scrollWidth - one.clientWidth)"
        )
    assert len(widths) >= 4 and max(widths) == 0


def test_the_charts_follow_the_colour_scheme(page):
    ink = f"getComputedStyle({EVERYWHERE}('svg text[fill=\"#444444\"]')[0]).fill"
    paper = "getComputedStyle(document.body).backgroundColor"
    light = page.run(ink), page.run(paper)
    page.emulate(1100, "dark")
    dark = page.run(ink), page.run(paper)
    page.emulate(1100, "dark", media="print")
    printed = page.run(ink), page.run(paper)
    page.emulate(1100)
    level = [[int(re.findall(r"\d+", colour)[0]) for colour in pair] for pair in (light, dark)]
    assert level[0][0] < 80 < 200 < level[0][1] and level[1][0] > 180 > 50 > level[1][1]
    assert printed[1] == "rgb(255, 255, 255)" and int(re.findall(r"\d+", printed[0])[0]) < 80


def test_print_has_every_section_and_no_tools(page, report, tmp_path):
    page.emulate(1100)
    path = tmp_path / "report.pdf"
    path.write_bytes(page.pdf())
    assert path.read_bytes().count(b"/Type /Page\n") + path.read_bytes().count(b"/Type /Page ") >= 3
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext is not installed (package poppler-utils)")
    done = subprocess.run(["pdftotext", "-layout", path, "-"], capture_output=True, check=True)
    text = " ".join(done.stdout.decode().split())
    headings = re.findall(r"<h2>([^<]*)</h2>", report.read_text("utf-8"))
    assert len(headings) > 8 and [one for one in headings if one not in text] == []
    assert "driving_eccentricity_mm" in text and "driving shaft [turns]" in text  # of a chart


def test_a_name_of_a_rig_is_no_program(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_drive(tmp_path / "log.csv")
    pair = {"name": NAME, "drive": {"ratio": "1/2"}}
    (tmp_path / "pair.toml").write_text(tomli_w.dumps(pair))
    fit = ["fit", "log.csv", "--pair", "pair.toml", "--out", "run", "--no-figures", "--report"]
    assert main(fit) == 0
    with Page(tmp_path / "profile") as page:
        page.open(tmp_path / "run" / "report.html", DRAWN)
        assert page.run("document.querySelector('h1').textContent") == NAME
        assert page.run("document.title") == NAME
        assert said(page) == [] and "Page.javascriptDialogOpening" not in str(page.events)
