"""Judgements: what a report says of setups is a row of one frame, and no sentence is made from anything else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import polars as pl

from ..model.metrics import frame_schema
from ..run_statistics.received import LossExcess
from ..statistics.intervals import Basis

LOSSY_SHARE = 0.01
"""Share of lost messages above which a report advises against a setup, as its p99 is a lost message."""
LOST_MUCH = f"lost more than {100 * LOSSY_SHARE:g} % of the messages planned"


class Claim(str, Enum):
    FASTEST = "leads"
    SLOWER = "takes longer"
    LOSES_MORE = "loses more"
    LOSSY = "lossy"
    OVER = "differs over"
    FROM = "differs from"
    ON = "differs on"
    THROUGH = "differs through"
    WITH = "differs with"
    MEETS = "meets"
    MISSES = "misses"
    OWN_NODES = "differs by less than our own nodes"
    CHANGED = "changed"
    KEEPS = "keeps"


class Reason(str, Enum):
    NONE = ""
    NOT_SHOWN = "not shown by a test"
    BELOW_MARGIN = "the lead is below the margin"
    IN_SEQUENCE = "recorded one after the other"
    DEPENDENT = "the passes depend on each other"
    FEW_RUNS = "fewer than three runs"
    ONLY_ONE = "only one setup"
    LOSSES = "the fastest one loses too much"
    FEW_LOST = "too few to judge"
    AS_REQUESTED = "too old messages are dropped as requested"
    REPLACED = "keep_last replaces messages at the highest rate"


DO_NOT_USE, PROVEN, OPEN = "do not use", "proven", "open"


@dataclass(frozen=True, slots=True)
class Judgement:
    """One row: a claim, what was measured (a ratio to the base, a difference or a share, with its interval), and what follows.

    Attributes:
        base: what it is compared with: a setup or a limit.
        verdict: `proven`, `open` or `do not use`.
        needs: repeats that would probably decide.
        group: first row of `summary` that it is about.
        lost: messages that were lost, of `messages`, where a claim is about losses.
    """

    claim: Claim
    subject: str
    statistic: str
    base: str = ""
    value: float | None = None
    low: float | None = None
    high: float | None = None
    basis: str = ""
    p: float | None = None
    p_adjusted: float | None = None
    verdict: str = OPEN
    reason: str = ""
    needs: int | None = None
    group: int | None = None
    lost: int | None = None
    messages: int | None = None


JUDGEMENT_SCHEMA = frame_schema(
    "claim:str subject:str statistic:str base:str value:f64 low:f64 high:f64 basis:str p:f64 p_adjusted:f64 verdict:str reason:str "
    "needs:u32 group:u32 lost:u64 messages:u64"
)


def judgement_frame(rows: Iterable[Judgement]) -> pl.DataFrame:
    values = [[getattr(row, name) for name in JUDGEMENT_SCHEMA] for row in rows]
    return pl.DataFrame(values, JUDGEMENT_SCHEMA, orient="row")


def judged_losses(subject: str, excess: LossExcess, group: int | None, requested: Reason) -> Judgement | None:
    """Judge whether a setup is advised against: more than `LOSSY_SHARE` is lost for sure, unrequested; None without a loss."""
    if not excess.lost:
        return None
    reason = requested
    if reason is Reason.NONE and not excess.is_sure() and exceeds_lossy_share(excess.share):
        reason = Reason.FEW_LOST
    is_advised = excess.is_sure() and requested is Reason.NONE
    return Judgement(
        *(Claim.LOSSY, subject, "lost", f"{LOSSY_SHARE:.0%}", excess.share, excess.low, excess.high),
        basis=(Basis.WITHIN_RUN if excess.p_value is None else Basis.BETWEEN_RUNS).value,
        p=excess.p_value,
        p_adjusted=excess.p_adjusted,
        verdict=DO_NOT_USE if is_advised else OPEN,
        reason=reason.value,
        group=group,
        lost=excess.lost,
        messages=excess.messages,
    )


def is_replacing(rate_hz: object, history: object) -> bool:
    """Return whether newer messages replace older ones as they leave."""
    return not rate_hz and history == "keep_last"


def exceeds_lossy_share(lost: float) -> bool:
    """Return whether a share is more than `LOSSY_SHARE`; 1 of 100 is not, though 1 - 0.99 is."""
    return round(lost, 9) > LOSSY_SHARE


def lossy_shares(received: Iterable[float | None]) -> tuple[float | None, ...]:
    return tuple(share if share is not None and exceeds_lossy_share(1 - share) else None for share in received)


Row = Mapping[str, Any]


def judged_change(claim: Claim, subject: str, row: Row, base: str, group: int | None = None) -> Judgement:
    numbers = row["ratio"], row["ratio_low"], row["ratio_high"], row["basis"], row["p_value"], row["p_adjusted"]
    return Judgement(claim, subject, f"{row['metric']}_{row['statistic']}", base, *numbers, row["verdict"], group=group)
