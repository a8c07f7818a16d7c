"""HTML report: one self-contained file that opens offline. Equal input gives equal bytes."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, fields
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape
from plotly.offline import get_plotlyjs

from dds_trace.analyzer.pairing.parquet import summary_parquet
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.analyzer.verdicts.judgements import LOST_MUCH
from dds_trace.base.files import asset
from dds_trace.base.printable import printable
from dds_trace.base.units import DECIMAL_BYTES, MISSING, SHOWN_NS, format_rate, format_size, utc_words
from dds_trace.base.version import YEAR, __version__

from ..blocks import PAGE, WITHIN_QUANTITY, Block, Facts, Heading, Points, Report, Sentence, plain_text, visible
from ..book.book import Book
from ..book.facets import MADE_OF, filters_info
from ..book.findings import finding_block, severity_counts, worst_first
from ..book.groups import (
    LATENCY_MEANING,
    METRIC_LABELS,
    METRIC_MENU,
    STATISTIC_LABELS,
    data_type_label,
    group_labels,
    is_of_topics,
    topic_parts,
)
from ..book.recording import file_table, recorded_environment
from ..book.sizes import HOW_TO_READ, TINTS, size_block
from ..figures.figure import ATOMS, AXIS_TITLES, MOST_LINES, Figure, Plan, Scope
from ..figures.table import drawn_figures, opened_figures
from .styles import line_styles

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


_CODE = re.compile(r"`([^`]+)`")
FOLDED_FACTS = ("Traces", "Quality of service", "Settings", "Versions", "Cost of measuring")
SCRIPTS = (
    "data.js",
    "units.js",
    "view.js",
    "layout.js",
    "kinds/facets.js",
    "kinds/lines.js",
    "kinds/bars.js",
    "kinds/few.js",
    "kinds/cell.js",
    "kinds/details.js",
    "kinds/wire.js",
    "tables.js",
    "output/export.js",
    "rows.js",
    "figures.js",
    "group.js",
    "output/paper.js",
    "job.js",
    "theme.js",
    "page.js",
)
"""Scripts of the page, each after those that it needs."""
UNPACK_SCRIPT = "unpack.js"
LIVE_SCRIPT = "live.js"


def render(report: Report) -> str:
    if isinstance(report, Book):
        return _render(report, SCRIPTS)
    return _of_sections(printable(report.title), report.kicker, report.scripts, visible(report.sections, PAGE))


def render_live(book: Book, version: str) -> str:
    return _render(book, (*SCRIPTS, LIVE_SCRIPT), version)


def render_waiting(version: str, why: str) -> str:
    words = [
        Heading("No trace can be analyzed yet"),
        Sentence("This page updates by itself."),
        Sentence(printable(why)),
    ]
    return _of_sections("Waiting for traces", Book.kicker, (*Report.scripts, LIVE_SCRIPT), [("answer", words)], version)


def _of_sections(
    title: str,
    kicker: str,
    scripts: Iterable[str],
    sections: Sequence[tuple[str, Sequence[Block]]],
    version: str | None = None,
) -> str:
    script = "\n".join(map(_asset, scripts))
    return _framed(
        "page.html.j2",
        policy=_policy(*filter(None, [script]), connect="" if version is None else "'self'"),
        version=version,
        style=Markup(_asset("page.css") + _asset("blocks.css")),  # noqa: S704 - our own files
        script=Markup(script),  # noqa: S704 - our own file
        title=title,
        kicker=kicker,
        begins=sections[0][0],
        sections=sections,
    )


def without_plotly(page: str) -> str:
    return page.replace(packed_script(get_plotlyjs()), "", 1)


def _render(book: Book, scripts: Iterable[str], version: str | None = None) -> str:
    plans, left_out = drawn_figures(book)
    drawn = [figure for figure, _ in plans]
    unpack, plotly, script = _asset(UNPACK_SCRIPT), get_plotlyjs(), "\n".join(map(_asset, scripts))
    facts, labels, sizes, answer = book.overview.facts, group_labels(book.groups), book.sizes, book.answer
    shown, folded = (
        Facts([(fact.label, fact.value) for fact in facts if (fact.label in FOLDED_FACTS) is is_folded])
        for is_folded in (False, True)
    )
    return _framed(
        "report.html.j2",
        policy=_policy(unpack, plotly, script, connect="" if version is None else "'self'"),
        version=version,
        style=Markup(_asset("page.css")),  # noqa: S704 - our own file
        unpack=Markup(unpack),  # noqa: S704 - our own file
        plotly=packed_script(plotly),
        script=packed_script(script),
        island=packed(json_island(_island(book, plans))),
        title=book.title,
        kicker="Latency report",
        bibtex=_BIBTEX,
        begins="figures" if drawn else "answer",
        overview=book.overview,
        formula=LATENCY_MEANING,
        facts=shown,
        folded_facts=folded,
        answer=answer,
        points=Points(answer.points),
        remarks=[Points(answer.remarks), *([Sentence(answer.rule, "rule")] if answer.rule else [])],
        sizes=sizes,
        size_table=size_block(sizes) if sizes else None,
        further=size_block(sizes, is_further=True) if sizes and any(site.further for site in sizes.places) else None,
        tints=TINTS,
        glance=book.glance,
        styles=line_styles(book.facets)["choice"],
        how_to_read_sizes=HOW_TO_READ,
        advice=book.advice_blocks(),
        findings=book.findings,
        finding_blocks=[finding_block(kind, labels) for kind in book.findings],
        severities=severity_counts(book.findings),
        group_names=[] if is_of_topics(book.analysis) else [*labels.values()],
        worst=next(iter(worst_first(book.values)), None),
        campaign_figures=[figure for figure in drawn if figure.scope is Scope.CAMPAIGN],
        cell_figures=[figure for figure in drawn if figure.scope is Scope.CELL],
        opened=opened_figures(book, drawn),
        left_out=left_out,
        recorded=[*recorded_environment(book.analysis, book.groups), *file_table(book.analysis)],
        topic_sections=topic_parts(book.analysis, "topic_sections"),
    )


_BIBTEX = f"""@software{{dds_trace,
  title = {{dds-trace: MCAP trace recorder and offline analyzer for the latency of ROS 2 / DDS communication}},
  author = {{{{The dds-trace maintainers}}}},
  version = {{{__version__}}},
  year = {{{YEAR}}},
  url = {{https://github.com/OWNER/dds-trace}}
}}"""


def _unbroken(value: object) -> object:
    """Keep a number and its unit in one line; what is markup was made by an earlier one."""
    return WITHIN_QUANTITY.sub("\u00a0", value) if type(value) is str else value


def _coded(text: str) -> Markup:
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(_unbroken(text)))))  # noqa: S704 - escaped


def _framed(template: str, version: str | None = None, **values: object) -> str:
    environment = Environment(
        loader=FunctionLoader(_asset),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_unbroken,
    )
    environment.filters["coded"] = _coded
    environment.globals.update(PAGE=PAGE, plain_text=plain_text)
    return environment.get_template(template).render(version=version, **values)


_asset = partial(asset, __package__)


def _policy(*scripts: str, connect: str) -> str:
    hashes = "".join(f" '{policy_hash(script)}'" for script in scripts)
    allowed = f"script-src{hashes}; " if hashes else ""
    return (
        f"default-src 'none'; {allowed}style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'" + (f"; connect-src {connect}" if connect else "")
    )


def _island(book: Book, plans: Sequence[tuple[Figure, Plan]]) -> dict[str, object]:
    groups, values, intervals = book.groups, book.values, book.intervals

    def by_group(value: Callable[[str, str, int], object]) -> object:
        return {
            metric: {name: [value(metric, name, group.index) for group in groups.groups] for name in columns}
            for metric, columns in intervals.rows.items()
        }

    filters, styles = filters_info(groups), line_styles(book.facets)
    return {
        "title": printable(book.analysis.title),
        "made_by": f"dds-trace {__version__}",
        "recommend": f"dds-trace choose {shlex.quote(printable(book.analysis.title))}",
        "metrics": [
            {"key": key, "label": label, "menu": METRIC_MENU.get(key, label)}
            for key, label in METRIC_LABELS.items()
            if values.has(key)
        ],
        "statistics": [{"key": key, "label": label} for key, label in STATISTIC_LABELS.items()],
        "filters": [
            {"key": filtering.key, "label": filtering.label, "options": filtering.options} for filtering in filters
        ],
        "groups": {
            "count": len(groups.groups),
            "series": [group.series for group in groups.groups],
            "cell": [group.cell for group in groups.groups],
            "filters": {filtering.key: filtering.index for filtering in filters},
        },
        "series": [{"label": label} for label in groups.labels],
        "percentiles": [
            {"key": p.name, "label": p.label, "share": p.quantile, "is_decade": p.is_decade} for p in PERCENTILES
        ],
        "facets": {
            "made_of": MADE_OF,
            "atoms": ATOMS,
            "most_lines": MOST_LINES,
            "titles": AXIS_TITLES,
            "lost_much": LOST_MUCH,
        },
        "units": {
            "missing": MISSING,
            **{
                kind: [(factor, unit) for unit, factor in units.items()]
                for kind, units in (("time", SHOWN_NS), ("bytes", DECIMAL_BYTES))
            },
        },
        "dimensions": {
            key: {
                "label": dimension.label,
                "index": dimension.index,
                "options": [
                    {"label": label, "short": short, **asdict(style)}
                    for label, short, style in zip(dimension.options, dimension.short, styles[key], strict=True)
                ],
            }
            for key, dimension in book.facets.dimensions.items()
        },
        "cells": [
            {
                "label": cell.label,
                "data": data_type_label(cell.data_type),
                "kind": printable(cell.data_type),
                "bytes": cell.payload_bytes,
                "size": format_size(cell.payload_bytes),
                "hz": cell.rate_hz,
                "rate": format_rate(cell.rate_hz),
            }
            for cell in groups.cells
        ],
        "values": values,
        "curves": book.curves,
        "parquet": base64.b64encode(summary_parquet(book.analysis.summary)).decode("ascii"),
        "runs": [
            {
                "group": run.group,
                "name": f"{run.run_id:016x}",
                "began": "" if run.session is None else utc_words(run.session.wall_ns(run.origin_ns)),
                "sent": run.published,
                "received": run.received,
                "p50_ns": run.p50_ns,
                "max_ns": run.max_ns,
            }
            for run in book.run_times
        ],
        "intervals": {
            "low_ns": by_group(lambda *where: intervals.ends(*where)[0]),
            "high_ns": by_group(lambda *where: intervals.ends(*where)[1]),
            "rests_on": by_group(intervals.rests_on),
            "typical_ns": by_group(intervals.typical),
        },
        "figures": {
            figure.name: {"title": figure.title, "follows": figure.follows, "kind": figure.kind, "plan": plan}
            for figure, plan in plans
        },
    }


def json_island(value: object) -> str:
    """Encode JSON that cannot end its `<script>` element: sorted keys, no NaN."""
    text = json.dumps(
        value, separators=(",", ":"), sort_keys=True, ensure_ascii=False, allow_nan=False, default=_fields
    )
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    # A lone surrogate (of a file name) cannot be written as UTF-8.
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _fields(record: DataclassInstance) -> dict[str, object]:
    # Not `asdict`, which copies every number of a campaign.
    return {field.name: getattr(record, field.name) for field in fields(record)}


@lru_cache(maxsize=4)  # plotly.js, and scripts of a watched folder
def packed_script(text: str) -> str:
    return packed(text)


def packed(text: str) -> str:
    """Return text as gzip in base64: letters, digits, `+`, `/` and `=`, which cannot end an element."""
    return base64.b64encode(gzip.compress(text.encode("utf-8"), mtime=0)).decode("ascii")


def policy_hash(script: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}"
