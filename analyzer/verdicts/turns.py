"""Two sides whose cells were measured in turns (`dds-sweep --against`): each cell of one has a partner on the other.

One plan against another measures unlike experiments on purpose, so that equal parameters do not tell what belongs
together. The runs say it: each run of the new side is labelled with the cell of the base whose turn it shared.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import polars as pl

from ..model.names import group_words, value_word, varying_parameters
from .matching import knows_relay

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from dds_trace.tracefile.format.descriptions import Run

    from .matching import Key

CELL_LABEL = "cell"
"""Label of a run with the name of its cell, without the number of the pass."""

AGAINST_LABEL = "against"
"""Label of a run with the name of the base's cell that it was measured against."""


def partner_keys(
    base: pl.DataFrame,
    new: pl.DataFrame,
    runs_of_base: Iterable[Run],
    runs_of_new: Iterable[Run],
    match: Sequence[str],
) -> dict[int, Key]:
    """Return for each run of the new side the group of the base that it was measured against.

    Args:
        base: round trips of the base: `run_id` and the match columns.
        new: those of the new side.
        runs_of_base: descriptions of its runs, with the label `cell`.
        runs_of_new: those of the new side, with the label `against`.
        match: names of the columns of a group.

    Returns:
        run_id -> values of `match`; without the runs whose partner was not recorded, or is more than one group.
    """
    cells = {run.run_id: run.labels[CELL_LABEL] for run in runs_of_base if CELL_LABEL in run.labels}
    groups: dict[str, set[Key]] = defaultdict(set)
    for run_id, *key in base.select("run_id", *match).unique().iter_rows():
        if run_id in cells:
            groups[cells[run_id]].add(tuple(key))
    only = {}
    for cell, keys in groups.items():
        known = {key for key in keys if knows_relay(key, match)} or keys  # a run that lost all left no relay
        if len(known) == 1:
            (only[cell],) = known
    measured = set(new["run_id"].unique().to_list())
    return {
        run.run_id: only[cell]
        for run in runs_of_new
        if run.run_id in measured and (cell := run.labels.get(AGAINST_LABEL, "")) in only
    }


def with_partners(new: pl.DataFrame, partners: Mapping[int, Key], match: Sequence[str]) -> pl.DataFrame:
    """Return the round trips of the new side, those of runs with a partner under the partner's parameters."""
    schema = {name: new.schema[name] for name in ("run_id", *match)}
    rows = [(run_id, *key) for run_id, key in partners.items()]
    theirs = pl.DataFrame(rows, schema=schema, orient="row")
    own = new.join(theirs, on="run_id", how="anti", maintain_order="left")
    renamed = new.drop(match).join(theirs, on="run_id", how="inner", maintain_order="left")
    return pl.concat([own, renamed.select(new.columns)])


def own_groups(new: pl.DataFrame, partners: Mapping[int, Key], match: Sequence[str]) -> dict[Key, Key]:
    """Return for each group of the new side that has a partner the partner's group."""
    rows = new.select("run_id", *match).unique(maintain_order=True).iter_rows()
    return {tuple(key): partners[run_id] for run_id, *key in rows if run_id in partners}


def asked_differences(groups: Mapping[Key, Key], match: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence for each group of the new side that was asked for something else than its partner.

    Args:
        groups: group of the new side -> that of the base (`own_groups`).
        match: names of the columns.
    """
    partners = list(groups.values())
    names = (
        varying_parameters(pl.DataFrame(partners, schema=list(match), orient="row"), match) if groups else []
    )
    sentences = []
    for own, partner in groups.items():
        new, base = dict(zip(match, own, strict=True)), dict(zip(match, partner, strict=True))
        unlike = [name for name in match if new[name] != base[name]]
        if unlike and knows_relay(own, match):
            listed = ", ".join(
                f"{name} {value_word(new[name])} instead of {value_word(base[name])}" for name in unlike
            )
            sentences.append(f"{group_words(base, names)}: the new side has {listed}.")
    return tuple(sentences)
