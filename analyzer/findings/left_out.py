"""Checks of what an analysis leaves out because of a campaign's size, or of `--sketch`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.units import counted

from ..engines.batches import WHOLE_GROUP_EVENTS
from ..model.finding import Finding, Severity
from ..model.parameters import BRIDGE_MATCH_COLUMNS, CASE_COLUMNS
from ..statistics.histogram import RELATIVE_ERROR
from ..verdicts.cases import MOST_COMPARED_ROWS, is_too_large, partition_groups
from .evidence import some

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .evidence import Evidence


def sketched(evidence: Evidence) -> Iterator[Finding]:
    """Report that percentiles come from histograms and that there are no rows."""
    if not evidence.options.rows:
        yield Finding(
            Severity.INFO,
            "sketched",
            "all groups",
            f"Percentiles come from histograms and may be off by {RELATIVE_ERROR:.2%} of their value; counts, means, "
            "standard deviations and extremes are exact. There are no rows, so no group is compared with another.",
            "Analyze without --sketch for exact percentiles, the rows in roundtrips.parquet, and who is fastest.",
        )


def stale_rows(evidence: Evidence) -> Iterator[Finding]:
    """Report the rows of an earlier analysis in the folder of a sketch, which replaces only what it writes."""
    if evidence.stale_rows is not None:
        yield Finding(
            Severity.INFO,
            "earlier_rows",
            evidence.stale_rows.name,
            "The rows in this file are those of an earlier analysis; the summary beside it was not made from them.",
            "Analyze without --sketch to replace them, or give a sketch a folder of its own with --out.",
        )


def groups_in_parts(evidence: Evidence) -> Iterator[Finding]:
    """Report groups without breakdown and responses, because no batch held them whole."""
    names, in_parts = evidence.group_names, evidence.in_parts
    if in_parts and evidence.details.requested:
        yield Finding(
            Severity.INFO,
            "group_in_parts",
            some(names[group] for group in in_parts),
            f"{counted(len(in_parts), 'group has', 'groups have')} more than {WHOLE_GROUP_EVENTS:,} events"
            f"{'' if len(in_parts) == 1 else ' each'} and {'was' if len(in_parts) == 1 else 'were'} worked at in parts: "
            "there is no breakdown of where their time goes, and no response against round trip time.",
            "Analyze a folder with fewer of their runs to see these.",
            in_parts,
        )


def cases_not_compared(evidence: Evidence) -> Iterator[Finding]:
    """Report groups that are not compared with others, because their kind of message has too many rows."""
    if not evidence.details.requested or not evidence.rows.has_rows:  # a sketch reports that by itself
        return
    kinds = (CASE_COLUMNS, BRIDGE_MATCH_COLUMNS)
    cases = [
        case for kind in kinds for case in partition_groups(evidence.rows.groups, kind) if is_too_large(case)
    ]
    if cases:
        names = evidence.group_names
        groups = sorted({group for case in cases for group in case["group"].to_list()})
        yield Finding(
            Severity.INFO,
            "not_compared",
            some(names[group] for group in groups),
            f"Of their kind of message there are more than {MOST_COMPARED_ROWS:,} rows: who is fastest, and what a "
            "bridge costs, is not told for it.",
            "Analyze a folder with fewer runs of each group to compare them.",
            tuple(groups),
        )
