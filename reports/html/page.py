"""HTML report: one self-contained file that opens offline. Equal input gives equal bytes."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import shlex
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from dds_trace.analyzer.exports.kinds import summary_parquet
from dds_trace.analyzer.statistics.percentiles import PERCENTILES
from dds_trace.base.files import asset
from dds_trace.base.printable import printable
from dds_trace.base.units import format_rate, format_size
from dds_trace.base.version import __version__

from ..blocks import PAGE, Facts, Points, Report, Sentence, plain_text, visible
from ..book.book import Book
from ..book.facets import MADE_OF
from ..book.findings import finding_block, severity_counts, worst_first
from ..book.groups import (
    LATENCY_MEANING,
    METRIC_LABELS,
    METRIC_MENU,
    STATISTIC_LABELS,
    Cell,
    Groups,
    Series,
    data_type_label,
    device_label,
    group_labels,
    qos_label,
)
from ..book.overview import utc_words
from ..book.recommendation import advice_blocks
from ..book.recording import record_tables, recorded_environment
from ..book.sizes import HOW_TO_READ, TINTS, size_block
from ..book.topics import topic_sections
from ..book.verdicts import MODES
from ..figures import drawn_figures, opened_figures
from ..figures.figure import ATOMS, MOST_LINES, Figure, LeftOut, Scope
from .styles import line_styles

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


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
    script = "\n".join(map(_asset, report.scripts))
    sections = visible(report.sections, PAGE)
    return _framed(
        "page.html.j2",
        policy=_policy(*filter(None, [script]), connect=""),
        style=Markup(_asset("page.css") + _asset("blocks.css")),  # noqa: S704 - our own files
        script=Markup(script),  # noqa: S704 - our own file
        title=printable(report.title),
        kicker=report.kicker,
        begins=sections[0][0],
        sections=sections,
    )


def render_live(book: Book, version: str) -> str:
    return _render(book, (*SCRIPTS, LIVE_SCRIPT), version)


def without_plotly(page: str) -> str:
    return page.replace(packed_script(get_plotlyjs()), "", 1)


def live_script() -> str:
    return _asset(LIVE_SCRIPT)


def _render(book: Book, scripts: Iterable[str], version: str = "") -> str:
    figures = drawn_figures(book)
    drawn = [(maker, figure) for maker, figure in figures if isinstance(figure, Figure)]
    unpack, plotly, script = _asset(UNPACK_SCRIPT), get_plotlyjs(), "\n".join(map(_asset, scripts))
    facts, labels, sizes, answer = book.overview.facts, group_labels(book.groups), book.sizes, book.answer
    shown, folded = (
        Facts([(fact.label, fact.value) for fact in facts if (fact.label in FOLDED_FACTS) is is_folded])
        for is_folded in (False, True)
    )
    return _framed(
        "report.html.j2",
        policy=_policy(unpack, plotly, script, connect="'self'" if version else ""),
        version=version,
        style=Markup(_asset("page.css")),  # noqa: S704 - our own file
        unpack=Markup(unpack),  # noqa: S704 - our own file
        plotly=packed_script(plotly),
        script=packed_script(script),
        island=packed(json_island(_island(book, [figure for _, figure in drawn]))),
        title=book.overview.title,
        kicker="Latency report",
        begins="figures",
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
        advice=[*advice_blocks(book.advice)],
        findings=book.findings,
        finding_blocks=[finding_block(kind, labels) for kind in book.findings],
        severities=severity_counts(book.findings),
        group_names=labels,
        worst=next(iter(worst_first(book.values)), None),
        campaign_figures=[(maker, figure) for maker, figure in drawn if maker.scope is Scope.CAMPAIGN],
        cell_figures=[(maker, figure) for maker, figure in drawn if maker.scope is Scope.CELL],
        opened=opened_figures(book, drawn),
        left_out=[figure for _, figure in figures if isinstance(figure, LeftOut)],
        recorded=[*recorded_environment(book.analysis, book.groups), *record_tables(book.analysis)],
        topic_sections=topic_sections(book.analysis),
    )


def _framed(template: str, version: str = "", **values: object) -> str:
    environment = Environment(
        loader=FunctionLoader(_asset), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
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


def _island(book: Book, figures: list[Figure]) -> dict[str, object]:
    groups, values, intervals = book.groups, book.values, book.intervals
    rests_on = {
        metric: {name: [intervals.rests_on(metric, name, group.index) for group in groups.groups] for name in columns}
        for metric, columns in intervals.is_between.items()
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
        "facets": {"made_of": MADE_OF, "atoms": ATOMS, "most_lines": MOST_LINES},
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
        "parquet": base64.b64encode(summary_parquet(book.analysis)).decode("ascii"),
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
        "intervals": {"low_ns": intervals.low_ns, "high_ns": intervals.high_ns, "rests_on": rests_on},
        "figures": {
            figure.name: {"title": figure.title, "follows": figure.follows, "kind": figure.kind, "plan": figure.plan}
            for figure in figures
        },
    }


@dataclass(frozen=True, slots=True)
class Option:
    value: str
    label: str


@dataclass(frozen=True, slots=True)
class Filter:
    """One filter of a page; `index` has the option of each group."""

    key: str
    label: str
    options: tuple[Option, ...]
    index: tuple[int, ...]


def _same(text: str) -> Option:
    return Option(text, text)


_FILTERS: tuple[tuple[str, str, Callable[[Cell, Series], Option]], ...] = (
    ("vendor", "Vendor", lambda _, s: _same(s.vendor_label)),
    ("domain", "Domains", lambda _, s: Option(s.domain_mode, MODES.get(s.domain_mode, printable(s.domain_mode)))),
    ("bridge", "Bridge", lambda _, s: _same(printable(s.bridge))),
    ("data", "Data", lambda c, _: Option(printable(c.data_type), data_type_label(c.data_type))),
    ("size", "Size", lambda c, _: Option(str(c.payload_bytes), format_size(c.payload_bytes))),
    ("rate", "Rate", lambda c, _: Option(f"{c.rate_hz:g}", format_rate(c.rate_hz))),
    ("qos", "QoS", lambda _, s: _same(qos_label(s))),
    ("device", "Devices", lambda _, s: _same(device_label(s))),
    ("backend", "Backend", lambda _, s: _same(printable(s.backend))),
    ("serialization", "Serialization", lambda _, s: _same(printable(s.serialization))),
    ("link", "Link", lambda _, s: _same(printable(s.connectivity))),
    ("setting", "Setting", lambda _, s: Option(printable(s.setting), printable(s.setting) or "nothing else set")),
)


def filters_info(groups: Groups) -> tuple[Filter, ...]:
    filters = []
    for key, label, option_of in _FILTERS:
        options = [option_of(groups.cell_of(group), groups.series_of(group)) for group in groups.groups]
        by_series = sorted(groups.groups, key=lambda group: (group.series, group.cell))
        distinct = list(dict.fromkeys(options[group.index] for group in by_series))
        if all(option.value.replace(".", "", 1).isdigit() for option in distinct):
            distinct.sort(key=lambda option: float(option.value))
        if len(distinct) > 1:
            rank = {option: index for index, option in enumerate(distinct)}
            filters.append(Filter(key, label, tuple(distinct), tuple(rank[option] for option in options)))
    return tuple(filters)


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


def unpacked(text: str) -> str:
    return gzip.decompress(base64.b64decode(text)).decode("utf-8")


def policy_hash(script: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}"
