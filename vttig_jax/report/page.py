"""The page of a report: one HTML file that holds everything it shows and makes no request."""

import base64
import gzip
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ..base.errors import UsageError
from ..base.files.run_folder import RunFolder
from ..base.files.text_tables import decimals
from ..base.results import TextResult
from ..base.shown_text import shown_name
from ..identify.result import PARAMETER_HEADERS, parameter_cells
from ..runs.run import open_run
from .charts import Chart, charts_of
from .comparison import HEADERS, Comparison, compare_runs
from .content import RunContent
from .verdict import next_steps, verdict
from .words import meanings

Place = str | Path
_HERE = Path(__file__)
_MOST_BYTES = 700_000  # of the pictures, and of the links, of all runs; chosen: 3 MB suffice

_COLOURS = {"A": "#3f90da", "B": "#bd1f01", "fit": "#444444", "band": "#94a4a2", "mark": "#832db6"}
"""Colours in the figures, which `page.js` replaces by those of the page in light, dark, print."""

_GLYPHS = {
    "line": ("line", {"x": "x", "y": "y"}, "line_color"),
    "mark": ("scatter", {"x": "x", "y": "y", "fill_color": None}, "line_color"),
    "band": ("varea", {"x": "x", "y1": "y", "y2": "upper"}, "fill_color"),
    "bars": ("vbar", {"x": "x", "top": "y", "line_color": None}, "fill_color"),
}
"""Kind of a series → method of a figure that draws it, its arguments, and what has the colour."""


@dataclass(frozen=True)
class Report(TextResult):
    """A report that was written: the object of schema `vttig.report/1`."""

    record: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Return the object of schema `vttig.report/1`."""
        return self.record

    def __str__(self) -> str:
        return "\n".join([*self.record["verdict"], "", f"report: {self.record['report']}"])


def require_bokeh() -> None:
    """Raise `UsageError` where Bokeh is not installed."""
    try:
        import bokeh.plotting  # noqa: F401
    except ImportError:
        cure = 'install it with `pip install "vttig-jax[report]"`'
        raise UsageError(f"a report needs the extra `report`; {cure}.") from None


def write_report(
    run: Place, other: Place | None = None, *, out: Place | None = None, overwrite: bool = False
) -> Report:
    """Write the report of a run folder, or of two side by side, as one HTML file.

    **Arguments**
    - `run`, `other`: run folders; `other` is the second of two runs that are compared.
    - `out`: HTML file; by default `report.html` in the folder of the (second) run.
    - `overwrite`: replace a file that exists.

    **Raises** `UsageError` without the extra `report`, for a folder without a fit and for an
    existing file, `InputError` for a fit that cannot be read.
    """
    require_bokeh()
    contents = [RunContent(open_run(folder)) for folder in (run, other) if folder is not None]
    path = contents[-1].run.folder / "report.html" if out is None else Path(out)
    with RunFolder(path.parent, overwrite=overwrite, results=(path.name,)) as writer:
        comparison = compare_runs(*contents) if len(contents) == 2 else None
        said = verdict(contents[0]) if comparison is None else comparison.verdict
        page = _page(contents, comparison, said)
        writer.write_bytes(path.name, data := page.encode("utf-8", "backslashreplace"))
    record = {"schema": "vttig.report/1", "report": str(path), "bytes": len(data)}
    record |= {"verdict": list(said), "sections": re.findall('<section id="([a-z]+)">', page)}
    return Report(record | {"comparison": comparison and comparison.to_json()})


def _page(contents: list[RunContent], comparison: Comparison | None, said: tuple[str, ...]) -> str:
    from bokeh.resources import Resources
    from jinja2 import Environment
    from markupsafe import Markup, escape

    def commands(text: str) -> Markup:  # set as such; all else is escaped
        return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))

    html, css, js = (_HERE.with_suffix(end).read_text("utf-8") for end in (".html", ".css", ".js"))
    drawn = [charts_of(content) for content in contents]
    rows = [(n, section, found) for n, run in enumerate(drawn) for section, found in run.items()]
    charts = {f"{s}-{k}-{n}": one for n, s, found in rows for k, one in enumerate(found)}
    bokeh = Resources(mode="inline", components=["bokeh"], minified=True).js_raw[0]
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"commands": commands, "name": shown_name, "base64": base64.b64encode}
    environment.globals |= {"numbers": _numbers, "next_steps": next_steps, "links": _links}
    environment.globals |= {"meanings": meanings, "headers": HEADERS}
    return environment.from_string(html).render(
        verdict=said,
        most=_MOST_BYTES // len(contents),
        comparison=comparison,
        runs=[(number, one, drawn[number]) for number, one in enumerate(contents)],
        style=Markup(css),
        figures=Markup(_figures(charts)),
        programs=[Markup(bokeh), Markup(js)],
    )


def _figures(charts: dict[Any, Chart]) -> str:
    """Return the figures of charts by the names of their places, as JSON for a script element."""
    from bokeh.embed import json_item
    from bokeh.themes import Theme

    theme = Theme(filename=str(_HERE.with_name("theme.json")))
    items = []
    for name, chart in charts.items():  # those of two runs have one scale
        peers = [own for place, own in charts.items() if place[:-1] == name[:-1]]
        items.append(json_item(_figure(chart, peers), name, theme))
    # A `<` in a text would end the element or begin another one.
    return json.dumps(items).replace("<", "\\u003c")


def _figure(chart: Chart, peers: list[Chart]) -> Any:
    """Return a figure of Bokeh with a scale for all `peers`; its numbers have 32 bits."""
    from bokeh.models import HoverTool
    from bokeh.plotting import figure

    plot = figure(tools="pan,box_zoom,xwheel_zoom,reset", active_drag="box_zoom")
    plot.xaxis.axis_label, plot.yaxis.axis_label = chart.x, chart.y
    ends = [end for one in peers for end in one.ends]
    margin = 0.05 * (max(ends) - min(ends)) or 1.0
    plot.y_range.update(start=min(ends) - margin, end=max(ends) + margin)
    if chart.ticks is not None:
        plot.xaxis.update(ticker=list(chart.ticks), major_label_overrides=chart.ticks)
        plot.xaxis.major_label_orientation = np.pi / 3
    small = lambda v: v if isinstance(v, list) else v.astype(np.float32)  # noqa: E731
    for one in chart.series:
        columns = {"x": one.x, "y": one.y, "upper": one.upper, **one.more}
        source = {k: small(v) for k, v in columns.items() if v is not None}
        glyph, ends, look = _GLYPHS[one.kind]
        look = {"source": source, look: _COLOURS[one.colour]}
        drawn = getattr(plot, glyph)(**ends, **look)
        if one.kind != "band" and one.colour != "fit":
            place = [] if one.kind == "bars" else [(chart.x, "@x{0.0000}")]
            tips = [("", one.name), *place, (chart.y, "@y{0.0000}")]
            for label, values in one.more.items():
                tips.append((label, f"@{{{label}}}{'' if isinstance(values, list) else '{0.000}'}"))
            mode = "mouse" if one.kind == "mark" else "vline"
            plot.add_tools(HoverTool(renderers=[drawn], tooltips=tips, mode=mode))
    return plot


def _numbers(content: RunContent) -> list[list[str]]:
    """Return the table of the parameters that are told, its headers first."""
    fit, drawn = content.run.fit, content.posterior.get("parameters", {})
    rows = [[*PARAMETER_HEADERS, *(["95 % of the draws"] if drawn else [])]]
    for p in (*fit.parameters.values(), *fit.regressors):
        if p.determined:
            places, own = decimals(p.std or 0.0, p.value or 0.0), drawn.get(p.name, {})
            ends = [f"{own[k]:z.{places}f}" for k in ("low95", "high95") if own.get(k) is not None]
            rows.append([*parameter_cells(p), *([" … ".join(ends) or "–"] if drawn else [])])
    return rows


def _links(contents: dict[str, bytes], left: int) -> Iterator[tuple[str, str, int]]:
    """Yield name, link that holds the file, and size of the files of a run; large ones are packed.

    The link is "" where the links together would have more than `left` bytes.
    """
    for name, data in contents.items():
        shown, href = name, f"data:text/plain;charset=utf-8,{quote(data, safe=',.-+:;')}"
        if len(href) > left / 2:
            packed = base64.b64encode(gzip.compress(data, mtime=0)).decode()
            shown, href = f"{name}.gz", f"data:application/gzip;base64,{packed}"
        href = href if len(href) <= left else ""
        left -= len(href)
        yield shown if href else name, href, len(data)
