"""A comparison as one HTML page in the report's style: offline, under a policy that runs its one script alone."""

from __future__ import annotations

import base64
import hashlib
from importlib.resources import files
from typing import TYPE_CHECKING

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from dds_trace.base.printable import printable

from ..book.groups import METRIC_LABELS, STATISTIC_LABELS
from ..changes import received_words, runs_words
from .drawings import curve, strip
from .words import (
    VERDICTS,
    both_words,
    change_words,
    gate_interval_words,
    interval_words,
    measured_words,
    survivors_words,
    why_words,
)

if TYPE_CHECKING:
    from .info import ComparedGroup, ComparisonInfo

_TONES = {
    "no reply came back": " bad",
    "loses more": " bad",
    "slower": " bad",
    "loses less": " good",
    "faster": " good",
}


def render(info: ComparisonInfo, title: str) -> str:
    """Return the page.

    Args:
        info: the comparison.
        title: names of the sides.
    """
    script = _asset("comparison", "comparison.js")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    shown = info.groups[0].shown() if info.groups else ()
    return environment.from_string(_asset("comparison", "comparison.html.j2")).render(
        policy=_policy(script),
        style=Markup(_asset("html", "page.css") + _asset("comparison", "comparison.css")),  # noqa: S704 - our own files
        script=Markup(script),  # noqa: S704 - our own file
        title=printable(title),
        info=info,
        shown_labels=[STATISTIC_LABELS.get(row["statistic"], row["statistic"]) for row in shown],
        groups=[_group(group) for group in info.groups],
        gates=[
            (
                one.result.gate.text,
                one.where,
                measured_words(one.result, one.result.measured),
                gate_interval_words(one.result),
                one.result.outcome.value,
                why_words(one.result),
            )
            for one in info.gates
        ],
    )


def _group(group: ComparedGroup) -> dict[str, object]:
    own = next((row for row in group.distributions if row["metric"] == group.changes[0]["metric"]), None)
    return {
        "label": group.label,
        "unlike": printable(group.unlike),
        "verdict": group.verdict,
        "where": group.where,
        "tone": _TONES.get(group.verdict, ""),
        "received": received_words(group.delivery),
        "strip": "" if own is None else strip(own),
        "curves": [curve(row) for row in group.distributions],
        "shown": [
            (both_words(row), change_words(row["ratio"]), interval_words(row)) for row in group.shown()
        ],
        "rows": [
            (
                f"{METRIC_LABELS.get(row['metric'], row['metric'])} {STATISTIC_LABELS.get(row['statistic'], row['statistic'])}",
                survivors_words(row, "base"),
                survivors_words(row, "new"),
                change_words(row["ratio"]),
                interval_words(row),
                runs_words(row),
                VERDICTS[row["verdict"]],
            )
            for row in group.changes
        ],
    }


def _asset(room: str, name: str) -> str:
    return (files(f"dds_trace.reports.{room}") / "assets" / name).read_text(encoding="utf-8")


def _policy(script: str) -> str:
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
