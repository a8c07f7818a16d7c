"""The analyzer's verdicts under the names of a report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any, TypeVar

from dds_trace.analyzer.model.names import Rule, device_pair, tell_apart, where_alike
from dds_trace.analyzer.model.parameters import ParameterValue
from dds_trace.analyzer.model.setting import choice_of, parse_setting
from dds_trace.analyzer.statistics.intervals import MIN_RUNS, Basis
from dds_trace.analyzer.verdicts.answers import FAMILY, CaseAnswer, Clarity
from dds_trace.base.link_words import link_words
from dds_trace.base.printable import printable
from dds_trace.base.units import counted, format_ratio

from .groups import VendorLabels, data_type_label, data_type_rank, setting_word, way_words

Key = TypeVar("Key", bound=Hashable)

CLEARLY = (
    "Setups are compared for the same message, on the same devices and link, at the median and, where every setup has enough messages "
    "for it, at p99. A setup is called fastest only where it is below each other one by a test of their runs at 95 % over all "
    "messages together, and by at least the margin (5 %, --margin); lost messages count as later than any other, and a setup that loses "
    "more than 1 % of the messages, or significantly more than another, never leads where another does not. With fewer than three runs, "
    "of setups recorded one after the other, and where neighbouring passes are alike there is no proven winner. A setup is advised "
    "against where surely more than 1 % is lost, by its runs and over all results. Plain sockets are not a middleware and not compared."
)
FEW_PASSES = " Three passes may not show that passes depend on each other."

WITHIN_ONE_RUN = (
    f"Setups are compared for the same message. A verdict needs {MIN_RUNS} runs of each: runs of equal settings differ by more than "
    "the messages within one run can show."
)

VERDICTS = {"worse": "slower", "better": "faster", "same": "the same", "inconclusive": "no clear change"}
MODES = {"same": "same domain", "different": "different domains"}

# Columns that extend equal labels of setups.
_FURTHER = (
    "backend",
    "relay_backend",
    "rmw",
    "reliability",
    "durability",
    "history",
    "depth",
    "serialization",
    "vendor",
    "bridge",
)


@dataclass(frozen=True, slots=True)
class WinCount:
    contender: str
    vendor: str
    cells: int


@dataclass(frozen=True, slots=True)
class DataVerdict:
    """Result for one kind of data at one `place` (devices, link, conditions), over all messages of two setups or more.

    Attributes:
        cells: number of compared messages.
        wins: the one with most messages first.
        inconclusive: number of messages without a clear winner.
        within_one_run: inconclusive messages for which a setup has fewer than three runs.
    """

    data: str
    mode: str
    cells: int
    wins: tuple[WinCount, ...]
    inconclusive: int
    place: str = ""
    within_one_run: int = 0


def verdicts_info(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> tuple[DataVerdict, ...]:
    setups = {setup.name: setup for answer in answers for setup in answer.contenders}
    labels = contender_labels(answers, vendors)
    families: dict[object, list[CaseAnswer]] = {}
    for answer in sorted(answers, key=_order):
        if answer.clarity is not Clarity.ONLY_ONE:
            families.setdefault(attrgetter(*FAMILY)(answer), []).append(answer)
    verdicts = []
    for cases in families.values():
        won = Counter(case.leaders[0].name for case in cases if case.clarity is Clarity.CLEAR)
        leads = sorted(won.items(), key=lambda lead: (-lead[1], lead[0]))
        unclear = [case for case in cases if case.clarity is Clarity.INCONCLUSIVE]
        mode = MODES.get(cases[0].domain_mode, printable(cases[0].domain_mode))
        verdicts.append(
            DataVerdict(
                data=f"{data_type_label(cases[0].data_type)}, {mode}",
                mode=mode,
                cells=len(cases),
                wins=tuple(WinCount(labels[name], str(setups[name].setting["vendor"]), count) for name, count in leads),
                inconclusive=len(unclear),
                place=place_of(cases[0]),
                within_one_run=sum(case.basis == Basis.WITHIN_RUN.value for case in unclear),
            )
        )
    return tuple(verdicts)


_CONDITION_WORDS = {
    "link": "emulated link {}",
    "flows": "{} runs at once",
    "relays": "{} relays",
    "outage_by": "by {}",
    "data": "data from {}",
}


def conditions_label(conditions: str) -> str:
    values = parse_setting(conditions)
    if "link" in values:
        values["link"] = link_words(values["link"])
    return printable(", ".join(_CONDITION_WORDS.get(key, f"{key} {{}}").format(value) for key, value in values.items()))


def link_label(connectivity: str, conditions: str, between: str = ", ") -> str:
    """The condition has an emulated link's name already."""
    emulated = parse_setting(conditions).get("link", "").partition("(")[0]
    way = "" if connectivity == f"emulated-{emulated}" else printable(connectivity)
    return between.join(filter(None, (way, conditions_label(conditions))))


def place_label(ping_device: str, relay_device: str | None, connectivity: str, conditions: str = "") -> str:
    return ", ".join(filter(None, (device_pair(ping_device, relay_device), link_label(connectivity, conditions))))


def place_of(answer: CaseAnswer) -> str:
    return place_label(answer.ping_device, answer.relay_device, answer.connectivity, answer.conditions)


def contender_labels(answers: Sequence[CaseAnswer], vendors: VendorLabels) -> dict[str, str]:
    return setup_labels({setup.name: setup.setting for answer in answers for setup in answer.contenders}, vendors)


def setup_labels(settings: Mapping[Key, Mapping[str, ParameterValue]], vendors: VendorLabels) -> dict[Key, str]:
    choices = [choice_of(str(setting["setting"])) for setting in settings.values()]
    word = setting_word(choices)
    parts: list[tuple[Rule, Callable[[Mapping[str, ParameterValue]], str]]] = [
        *((where_alike, partial(_value, column)) for column in _FURTHER),
        (where_alike, lambda setting: word(choice_of(str(setting["setting"])))),
    ]
    return dict(zip(settings, tell_apart(list(settings.values()), partial(_label, vendors), parts), strict=True))


def _label(vendors: VendorLabels, setting: Mapping[str, ParameterValue]) -> str:
    relay_vendor = setting["relay_vendor"]
    pair = vendors.of_pair(str(setting["vendor"]), None if relay_vendor is None else str(relay_vendor))
    return pair if setting["bridge"] == "none" else f"{pair} {way_words(str(setting['bridge']))}"


def _value(column: str, setting: Mapping[str, ParameterValue]) -> str:
    value = setting[column]
    if value is None and column.startswith("relay_"):
        return "relay unknown"
    return printable(f"depth {value}" if column == "depth" else "none" if value is None else value)


def _order(answer: CaseAnswer) -> tuple[object, ...]:
    relay = answer.relay_device
    where = answer.connectivity, answer.ping_device, relay is None, relay or "", answer.conditions
    return *data_type_rank(answer.data_type), answer.domain_mode != "same", *where


def runs_words(row: Mapping[str, Any]) -> str:
    if row["pairs"]:
        return f"{row['pairs']} pairs"
    runs = row["base_runs"], row["new_runs"]
    return "{} and {}".format(*runs) + (f", {few_words(min(runs))}" if row["basis"] == Basis.WITHIN_RUN.value else "")


def few_words(fewest_runs: float) -> str:
    return Basis.WITHIN_RUN.value if fewest_runs < MIN_RUNS else "too short"


def received_words(row: Mapping[str, Any]) -> str:
    return share_words(row["base_received_ratio"], row["new_received_ratio"])


def share_words(base: float | None, new: float | None) -> str:
    return " → ".join(dict.fromkeys(map(format_ratio, (base, new))))


def episodes_words(row: Mapping[str, Any], side: str) -> str:
    bursts = row[f"{side}_episodes"]
    is_tail = row["statistic"].startswith("p9") and row[f"{side}_ns"] is not None
    return counted(bursts, "burst") if is_tail and bursts is not None else ""
