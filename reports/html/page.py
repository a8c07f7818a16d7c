"""The HTML report: one file that stands alone, opens offline and asks nothing of any network.

The page holds every number once, as JSON; `assets/*.js` draw figures and tables from it and from the reader's
filters. Equal input gives equal bytes: no clock, no random id.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import asdict
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from dds_trace.tracefile.units.rates import format_rate
from dds_trace.tracefile.units.sizes import format_size

from ..book.answer import answer_info
from ..book.curves import curves_info
from ..book.findings import findings_info, severity_counts
from ..book.groups import METRICS, STATISTICS, data_type_label, groups_info
from ..book.intervals import intervals_info
from ..book.overview import overview_info
from ..book.recording import record_tables
from ..book.values import values_info
from ..figures import CAMPAIGN_FIGURES, CELL_FIGURES, Figure, LeftOut
from ..text import json_island, visible
from .filters import filters_info
from .styles import PALETTE, series_styles, vendor_places

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from dds_trace.analyzer.analysis import Analysis

    from ..book.answer import Answer

FILE_NAME = "report.html"
SCRIPTS = (
    "data.js",
    "units.js",
    "view.js",
    "layout.js",
    "kinds.js",
    "details.js",
    "tables.js",
    "export.js",
    "figures.js",
    "page.js",
)
"""In the order in which they need one another."""
LIVE_SCRIPT = "live.js"

FORMULA = (
    "Latency is (round trip - time in the relay) / 2, each of the two measured on one device's own clock."
)


def render(analysis: Analysis) -> str:
    """The page."""
    return _render(analysis, SCRIPTS)


def render_live(analysis: Analysis, version: str) -> str:
    """The page for a server: it loads itself again, with the view it has, once `GET version` answers another version."""
    return _render(analysis, (*SCRIPTS, LIVE_SCRIPT), version)


def live_script() -> str:
    """What makes a page look for a newer one; `data-version` of its root element is its own version."""
    return _asset(LIVE_SCRIPT)


def _render(analysis: Analysis, scripts: Iterable[str], version: str = "") -> str:
    campaign = [figure(analysis) for figure in CAMPAIGN_FIGURES]
    cell = [figure(analysis) for figure in CELL_FIGURES]
    findings = findings_info(analysis)
    drawn = [figure for figure in (*campaign, *cell) if isinstance(figure, Figure)]
    # A closing tag inside would end the element. Plotly's file and ours have none; a later one must not surprise us.
    plotly, script = (_safe_script(text) for text in (get_plotlyjs(), "\n".join(map(_asset, scripts))))
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(_asset("report.html.j2")).render(
        policy=_policy(plotly, script, connect="'self'" if version else ""),
        version=version,
        style=Markup(_asset("page.css")),  # noqa: S704 - our own file
        plotly=Markup(plotly),  # noqa: S704 - from plotly's own package
        script=Markup(script),  # noqa: S704 - our own files
        island=Markup(json_island(_island(analysis, drawn))),  # noqa: S704 - `json_island` escapes
        overview=overview_info(analysis),
        formula=FORMULA,
        answer=_answer(analysis, answer_info(analysis)),
        findings=findings,
        severities=severity_counts(findings),
        campaign_figures=[figure for figure in campaign if isinstance(figure, Figure)],
        cell_figures=[figure for figure in cell if isinstance(figure, Figure)],
        left_out=[figure for figure in (*campaign, *cell) if isinstance(figure, LeftOut)],
        record_tables=record_tables(analysis),
    )


def write(analysis: Analysis, folder: Path) -> Path:
    """Writes the page into `folder` and says where."""
    path = folder / FILE_NAME
    path.write_text(render(analysis), encoding="utf-8", newline="\n")
    return path


def _asset(name: str) -> str:
    return (files("dds_trace.reports.html") / "assets" / name).read_text(encoding="utf-8")


def _safe_script(text: str) -> str:
    return text.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _policy(*scripts: str, connect: str) -> str:
    """Only the page's own two scripts run and nothing is fetched from anywhere but `connect`, if that is given.

    Styles may be inline, because plotly.js writes style attributes; pictures are those that a download is made of.
    """
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
        for script in scripts
    )
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'" + (f"; connect-src {connect}" if connect else "")
    )


def _island(analysis: Analysis, figures: list[Figure]) -> dict[str, Any]:
    groups, values = groups_info(analysis), values_info(analysis)
    filters = filters_info(groups)
    return {
        "title": visible(analysis.title),
        "metrics": [{"key": key, "label": label} for key, label in METRICS.items() if values.has(key)],
        "statistics": [{"key": key, "label": label} for key, label in STATISTICS.items()],
        "filters": [{"key": one.key, "label": one.label, "options": one.options} for one in filters],
        "groups": {
            "count": len(groups.groups),
            "series": [group.series for group in groups.groups],
            "cell": [group.cell for group in groups.groups],
            "filters": {one.key: one.of_group for one in filters},
        },
        "series": [
            {"label": label, "different": one.domain_mode == "different", **asdict(style)}
            for label, one, style in zip(groups.labels, groups.series, series_styles(groups), strict=True)
        ],
        "cells": [
            {
                "label": cell.label,
                "data": data_type_label(cell.data_type),
                "bytes": cell.payload_bytes,
                "size": format_size(cell.payload_bytes),
                "hz": cell.rate_hz,
                "rate": format_rate(cell.rate_hz),
            }
            for cell in groups.cells
        ],
        "values": values,
        "curves": curves_info(analysis),
        "intervals": intervals_info(analysis),
        "figures": {
            figure.name: {"title": figure.title, "kind": figure.kind, "plan": figure.plan}
            for figure in figures
        },
    }


def _answer(analysis: Analysis, answer: Answer) -> dict[str, Any]:
    """The answer with each verdict's parts in their vendors' colours; the inconclusive part has none."""
    places = vendor_places(groups_info(analysis))
    verdicts = []
    for verdict in answer.verdicts:
        parts = [
            {"name": win.contender, "cells": win.cells, "light": light, "dark": dark}
            for win in verdict.wins
            for light, dark in [PALETTE[places[win.vendor] % len(PALETTE)]]
        ]
        if verdict.inconclusive:
            parts.append({"name": "inconclusive", "cells": verdict.inconclusive, "light": "", "dark": ""})
        verdicts.append({"data": verdict.data, "parts": parts})
    return {"headline": answer.headline, "verdicts": verdicts, "remarks": answer.remarks, "rule": answer.rule}
