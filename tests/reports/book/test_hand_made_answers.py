"""The first sentences of answers, costs and losses that are made by hand, so that each of their cases is met."""

from dataclasses import replace
from itertools import permutations
from math import inf

import polars as pl
import pytest
from analyses import BRIDGED, MS, ZENOH, Measured, around, make_analysis
from wording import numbers

from dds_trace import Finding, Severity
from dds_trace.analyzer.model.detail_frames import RECOVERY_SCHEMA
from dds_trace.analyzer.model.parameters import CONTENDER_COLUMNS
from dds_trace.analyzer.statistics.intervals import Basis, Interval
from dds_trace.analyzer.verdicts.answers import CaseAnswer, Clarity
from dds_trace.analyzer.verdicts.cases import Contender
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, OPEN, PROVEN, Claim, Judgement, Reason
from dds_trace.reports.book.answer import PointKind
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.fastest import fastest_setups, lowest_sentence, tail_sentence, winner_sentences
from dds_trace.reports.book.groups import VendorLabels
from dds_trace.reports.book.headline import bridge_sentence
from dds_trace.reports.book.losses import avoid_sentence, cure_sentence, few_lost_sentence
from dds_trace.reports.book.screen import MOST_LINES
from dds_trace.reports.book.verdicts import contender_labels
from dds_trace.reports.terminal import render

UNKNOWN = Interval(None, None, None, 0.95, 60, 60, Basis.BETWEEN_RUNS, 3, 3, None)
VENDORS = VendorLabels({})
FAST = around(MS)
SLOW = around(10 * MS)


def setup(name, p50_ms=1.0, p99_ms=None, lost=0.0, tiers=("", ""), *, loses_more=False):
    setting = dict.fromkeys(CONTENDER_COLUMNS, "") | {"vendor": name, "relay_vendor": name, "bridge": "none"}
    return Contender(
        name,
        setting,
        UNKNOWN,
        replace(UNKNOWN, value=1 - lost),
        loses_more=loses_more,
        p50_ns=None if p50_ms is None else p50_ms * MS,
        p99_ns=None if p99_ms is None else p99_ms * MS,
        letters_p50=tiers[0],
        letters_p99=tiers[1],
    )


def shown(setups, p50, p99):
    """The rows that follow from medians, p99s and letters of setups: who leads, and who takes longer than whom."""
    for name, leader in (("p50", p50), ("p99", p99)):
        times = {one.name: getattr(one, f"{name}_ns") for one in setups if getattr(one, f"{name}_ns") is not None}
        letters = {one.name: set(getattr(one, f"letters_{name}")) for one in setups}
        if leader:
            others = [ns / times[leader] for other, ns in times.items() if other != leader and ns >= times[leader]]
            yield Judgement(Claim.FASTEST, leader, f"latency_{name}", value=min(others, default=1.0), verdict=PROVEN)
        for slow, base in permutations(times, 2):
            if letters[slow] and letters[base] and not letters[slow] & letters[base] and times[slow] > times[base]:
                value = times[slow] / times[base]
                yield Judgement(Claim.SLOWER, slow, f"latency_{name}", base, value, verdict=PROVEN)


def case(*setups, size=1000, p50="", p99="", mode="same", data_type="binary", rate_hz=10.0, device="d", **more):
    more.setdefault("judgements", tuple(shown(setups, p50, p99)))
    clarity = Clarity.ONLY_ONE if len(setups) == 1 else Clarity.INCONCLUSIVE
    return CaseAnswer(
        *("wired", mode, data_type, size, rate_hz, "p50", clarity, setups, ()),
        **({"ping_device": device, "relay_device": device, "leader_p50": p50, "leader_p99": p99} | more),
    )


def lost_row(name, share, verdict=DO_NOT_USE, reason="", group=0):
    fields = {"verdict": verdict, "reason": reason, "group": group, "lost": round(128 * share), "messages": 128}
    return Judgement(Claim.LOSSY, name, "lost", value=share, **fields)


A, B, C = setup("a", 2.0), setup("b", 4.0), setup("c", 10.0)
TESTED = tuple(replace(one, letters_p99="a") for one in (A, B))
TAILS = setup("a", 2.0, 30.0, tiers=("a", "b")), setup("b", 4.0, 10.0, tiers=("b", "a"))
TIERS = setup("a", 2.0, tiers=("a", "")), setup("b", 2.2, tiers=("a", "")), setup("c", 10.0, tiers=("b", ""))

TAIL_OF_ONE = (
    setup("a", 2.0, 4.0, tiers=("a", "ab")), setup("b", 4.0, 3.9, tiers=("b", "a")), setup("c", 9.0, 11.7, tiers=("c", "b")),
)  # fmt: skip
MIDDLE = setup("a", 2.0, tiers=("ab", "")), setup("b", 2.2, tiers=("a", "")), setup("c", 11.0, tiers=("b", ""))


def losing(name):
    return case(A, B, p50="a", judgements=(*shown((A, B), "a", ""), lost_row(name, 0.5)))


SLOW_TAILS = [
    replace(one, p50_ns=None, letters_p50="", p99_ns=ns * MS, letters_p99=tier)
    for one, ns, tier in zip(TIERS, (2, 2, 8), "aab", strict=True)
]


def by_size(won, **more):
    """A kind of message for each letter: who has the lower median at it, `-` if nobody."""
    setups = {"a": (A, B), "b": (setup("a", 6.0), setup("b", 2.0)), "-": (A, B)}
    return [case(*setups[one], size=place * 1000, p50=one.strip("-"), **more) for place, one in enumerate(won, 1)]


def on_devices(won):
    return [one for place, each in enumerate(won) for one in by_size(each, device=f"d{place}")]


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        pytest.param(
            [case(A, B, p50="a", mode="different"), *by_size("b", data_type="string")],
            [1, 3, 1, 2],
            id="same domain first, each data type by name",
        ),
        pytest.param(on_devices("aa"), [2, 1, 2], id="two pairs alike"),
        pytest.param(on_devices("aabab"), [1, 2, 2], id="three of five pairs alike"),
        pytest.param(
            [case(setup("a", 2.0, 3.0), setup("b", 4.0, 12.0), p50="a", p99="a")], [1, 2, 4], id="both percentiles"
        ),
        pytest.param([case(*TAILS, p50="a", p99="b")], [1, 2, 3], id="a leader for each percentile"),
        pytest.param([case(*TAILS, p99="b")], [1, 3], id="a leader at p99 only"),
        pytest.param([case(*SLOW_TAILS)], [1, 4], id="one is slower at p99 only"),
        pytest.param([case(*TESTED, p50="a")], [1, 2], id="no difference at p99"),
        pytest.param([case(*TAIL_OF_ONE, p50="a")], [1, 2, 3, 1], id="a difference at p99 and nobody leads there"),
        pytest.param([case(*MIDDLE)], [1, 5], id="slower than one that is not the lowest"),
        pytest.param(by_size("aba"), [1, 2, 2, 3, 3, 2], id="three stretches stay apart"),
        pytest.param(
            by_size("-ba-a"), [3, 5, 2, 2, 3, 1, 4, 2, 4], id="five stretches are joined, undecided ones last"
        ),
        pytest.param(by_size("baaa"), [1, 3, 2, 2], id="from a size on"),
        pytest.param(by_size("aaab"), [3, 2, 4, 3], id="up to a size"),
        pytest.param(by_size("baab"), [1, 3, 2, 3, 2, 4, 3], id="sizes between"),
        pytest.param(
            [*by_size("aa", rate_hz=10.0), *by_size("ab", rate_hz=20.0)], [1, 2, 2, 1, 2, 1], id="depends on the rate"
        ),
        pytest.param([case(*TIERS)], [1, 5], id="one is slower than two"),
        pytest.param(
            [case(TIERS[0], replace(TIERS[1], p50_ns=30 * MS), TIERS[2])],
            [1, 5],
            id="open, and above one that is slower",
        ),
        pytest.param(
            [case(*TIERS), case(A, B, setup("c", 20.0), rate_hz=20.0)],
            [1, 5, 1, 2],
            id="slower at one rate, open at another",
        ),
        pytest.param(
            [case(TIERS[0], replace(TIERS[1], loses_more=True), TIERS[2])], [1, 5], id="one is slower, one loses more"
        ),
        pytest.param([case(*TIERS[:2], replace(TIERS[2], p50_ns=inf))], [1], id="slower as it lost messages"),
        pytest.param([case(A, replace(B, p50_ns=None), C, p50="a")], [1, 5], id="one without a median"),
        pytest.param([case(A, replace(B, p50_ns=inf), p50="a")], [1], id="the other lost its messages"),
        pytest.param([losing("a")], [1, 2], id="the leader loses"),
        pytest.param([losing("b")], [1, 2], id="the other loses"),
        pytest.param([case(setup("a", 1.0), setup("b", 1000.0), p50="a")], [1, 1000], id="a thousand times"),
    ],
)
def test_who_is_fastest(answers, said, sentences):
    labels = contender_labels(answers, VENDORS)
    found = [*winner_sentences(fastest_setups(answers, VENDORS)), tail_sentence(answers, labels)]
    sentences(*found)
    assert numbers(" ".join(found)) == said


def test_the_middle_rate_is_shown_and_what_takes_least_runs_comes_first():
    cases = [case(A, B, p50="a", rate_hz=rate_hz) for rate_hz in (10.0, 20.0, 50.0)]
    assert fastest_setups(cases, VENDORS)[0].shown.rate_hz == 20
    judged = [
        (Judgement(Claim.FASTEST, "a", "", needs=needs), one) for needs, one in zip((None, 9, 7), cases, strict=True)
    ]
    assert numbers(lowest_sentence(judged, contender_labels(cases, VENDORS)))[1::5] == [50, 20, 10]


def lossy(*shares, size=1000, device="d", **more):
    named = [(name, share) for name, share in zip("abcdef", shares, strict=False)]
    rows = tuple(lost_row(name, share, **more) for name, share in named if share)
    return case(*(setup(name, lost=lost) for name, lost in named), size=size, device=device, judgements=rows)


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        pytest.param([lossy(0.25, 0.5)], [1, 10, 50, 1, 10, 25], id="the worst first"),
        pytest.param(
            [lossy(0.125, 0), lossy(0.125, 0.5, size=2000)],
            [2, 10, 50, 1, 10, 12.5, 2, 10, 12.5],
            id="each size by itself",
        ),
        pytest.param([lossy(0.25, 0.5, 0.125, 0.125)], [1, 10, 50, 1, 10, 25, 1, 10, 12.5, 1], id="four results"),
        pytest.param(
            [lossy(0.5, 0, device="d1"), lossy(0.25, 0, device="d2")], [1, 10, 50, 1, 10, 25], id="on two devices"
        ),
        pytest.param([lossy(0.25, 0, verdict=OPEN)], [], id="not for sure"),
        pytest.param([lossy(0.25, 0, group=7)], [], id="with a cure"),
    ],
)
def test_what_is_not_to_be_used(answers, said, sentences):
    found = avoid_sentence(answers, VENDORS, {7: "give both sides --depth 126"})
    sentences(found)
    assert numbers(found) == said


def test_the_largest_of_the_cures_is_named_and_few_losses_are_not_judged(sentences):
    groups = Book(make_analysis(Measured(HALF), Measured(HALF, **ZENOH), Measured(FAST, rate_hz=20.0))).groups
    cures = {group: f"give both sides --depth {depth}" for group, depth in enumerate((9, 12, 126))}
    found = [cure_sentence(groups, {group: cures[group] for group in cured}) for cured in ((0, 2, 1), (0, 1), (1,))]
    few = few_lost_sentence([lossy(0.015625, 0.5, verdict=OPEN, reason=Reason.FEW_LOST.value)], VENDORS)
    sentences(*found, few)
    assert [*map(numbers, found)] == [[126], [10, 20, 9], []]
    assert numbers(few) == [1, 10, 64, 128, 1, 10, 2, 128]


COST = {
    "bridge": pl.String, "vendor": pl.String, "relay_vendor": pl.String, "metric": pl.String,
    "statistic": pl.String, "verdict": pl.String, "ratio": pl.Float64,
}  # fmt: skip


def costs(*rows):
    return pl.DataFrame([(*row[:3], "latency", *row[3:]) for row in rows], COST, orient="row")


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        pytest.param(costs(("b", "v", "v", "p50", "worse", 2.0)), [2], id="one"),
        pytest.param(
            costs(*(("b", "v", "v", "p50", *each) for each in (("worse", 2.0), ("worse", None), ("same", 1.0)))),
            [2, 1, 1, 3],
            id="one lost, one the same",
        ),
        pytest.param(
            costs(*(("b", "v", "v", name, "worse", 3.0) for name in ("p50", "p99"))), [3, 3], id="both percentiles"
        ),
        pytest.param(
            costs(*(("b", vendor, None, "p50", "worse", float(place)) for place, vendor in enumerate("zaybxcwd", 2))),
            [2, 3, 4, 5, 6, 7, 8, 9],
            id="vendors in the order of the rows",
        ),
        pytest.param(
            costs(("b", "v", "w", "p50", "worse", 2.0), ("b", "w", "w", "p50", "worse", 3.0)), [2, 3], id="two vendors"
        ),
        pytest.param(costs(("b", "v", "v", "p50", "same", 1.0)), [], id="no cost"),
        pytest.param(costs(("b", "v", "v", "p50", "better", 0.15)), [0.15], id="a gain"),
        pytest.param(
            costs(*(("b", "v", "v", "p50", *each) for each in (("worse", 2.0), ("better", 0.5), ("same", 1.0)))),
            [2, 0.5, 1, 1, 3],
            id="a cost, a gain and neither",
        ),
    ],
)
def test_what_a_bridge_costs(rows, said, sentences):
    found = bridge_sentence(rows, VENDORS)
    sentences(found)
    assert numbers(found) == said


HALF = [*FAST[10:], *["lost_return"] * 10]


@pytest.mark.parametrize(
    ("measured", "said"),
    [
        pytest.param([Measured(FAST), Measured(HALF, **ZENOH)], [25, 10, 40], id="by one of two"),
        pytest.param(
            [Measured(HALF), Measured(FAST, bridge="builtin", domain_mode="different", **ZENOH)],
            [25, 10, 40],
            id="one way",
        ),
        pytest.param(
            [Measured(FAST, connectivity="a"), *(Measured(HALF, connectivity=link) for link in "bcd")],
            [37.5, 30, 80],
            id="over three of four links",
        ),
        pytest.param(
            [Measured(HALF if size == 2000 else FAST, payload_bytes=size) for size in (1000, 2000, 3000)]
            + [Measured(FAST, payload_bytes=3000, **ZENOH)],
            [12.5, 10, 80, 2],
            id="at one of three sizes, which the other was not measured with",
        ),
    ],
)
def test_where_messages_were_lost(measured, said, sentences):
    found = Book(make_analysis(*measured)).answer.headline
    sentences(found)
    assert numbers(found) == said


def test_a_cause_is_said_of_what_lost_messages(sentences):
    found = [("fragments_lost", 0), ("fragments_lost", 0), ("udp_buffer_overflow", 1)]
    seen = tuple(Finding(Severity.WARNING, code, "", f"{code}.", "It: try less.", (group,)) for code, group in found)
    analysis = make_analysis(Measured(HALF), Measured(FAST, **ZENOH))
    books = [Book(replace(analysis, findings=findings)) for findings in (seen, seen[1:], seen[2:])]
    causes = [[text for kind, text in book.answer.sentences if kind is PointKind.CAUSE] for book in books]
    assert [["1 more" in text for text in each] for each in causes] == [[True], [False], []]
    sentences(*causes[0], *causes[1])


def test_how_long_each_setup_took_to_come_back(sentences):
    settings = [f"outage={length},outage_by=link" for length in ("2s", "12s")]
    ways = [{}, {}, BRIDGED, BRIDGED]
    analysis = make_analysis(*(Measured(FAST, setting=one, **way) for one, way in zip(settings * 2, ways, strict=True)))
    backs = {0: [5 * MS, 0, None], 1: [None], 2: [0], 3: [MS, 3 * MS, 2 * MS, 4 * MS]}
    rows = [
        {"group": group, "run_id": run, "by": "link", "never": back is None, "back_ns": back}
        for group, times in backs.items()
        for run, back in enumerate(times)
    ]
    details = replace(analysis.details, recoveries=pl.DataFrame(rows, RECOVERY_SCHEMA))
    answer = Book(replace(analysis, details=details)).answer
    said = [text for kind, text in answer.sentences if kind is PointKind.RECOVERY]
    assert not [text for text in answer.points if "outage_by" in text]
    assert said[0] == answer.headline
    assert [["after 2s" in text, "never" in text, "at once" in text] for text in said] == [
        [True, True, False],
        [False, True, True],
    ]
    sentences(*said)


@pytest.mark.parametrize(("processes", "errors", "is_said"), [(4, 0, True), (4, 2, True), (4, 9, True), (5, 0, False)])
def test_a_machine_busy_in_a_quarter_of_processes_is_named_on_every_first_screen(processes, errors, is_said, sentences):
    analysis = make_analysis(Measured(FAST, ping_device="vm", relay_device="vm", connectivity="loopback"))
    full = Finding(Severity.WARNING, "cpu_saturated", "session", "It was full.", "Free it.")
    others = (replace(full, severity=Severity.ERROR, code=f"error_{n}", what="So. " * 60) for n in range(errors))
    sample = analysis.details.host_samples.head(1)
    samples = (sample.with_columns(session_id=pl.lit(n, dtype=pl.UInt64)) for n in range(processes))
    details = replace(analysis.details, host_samples=pl.concat(samples))
    book = Book(replace(analysis, details=details, findings=(full, *others)))
    lines = render(book).splitlines()
    assert (len(lines) <= MOST_LINES, "busy during 1 of 4" in " ".join(lines)) == (True, is_said)
    sentences(*(text for kind, text in book.answer.sentences if kind in (PointKind.WHERE, PointKind.DOUBT)))


def undecided(number, reason):
    measured = (1.023, 1.007, 1.039) if reason is Reason.BELOW_MARGIN else (1.5, 0.9, 2.0)
    row = Judgement(Claim.FASTEST, "a", "latency_p50", "b", *measured, reason=reason.value)
    unlike = {"mode": ("same", "different")[number - 1], "data_type": ("binary", "string")[number - 1]}
    unlike |= {"basis": Basis.WITHIN_RUN.value, "interleaved": False}
    return case(A, B, judgements=(row,), fewest_runs=2, size=number * 1000, rate_hz=number * 10.0, **unlike)


@pytest.mark.parametrize(
    ("reasons", "said"),
    [
        ((Reason.FEW_RUNS, Reason.ONLY_ONE), [3, 2, 1, 2, 4]),
        ((Reason.NOT_SHOWN, Reason.NOT_SHOWN), [2, 1, 10, 2, 4, 2, 20, 2, 4]),
        ((Reason.NOT_SHOWN, Reason.FEW_RUNS), [2, 1, 10, 2, 4, 2, 20, 2, 4, 1, 1, 3, 2]),
        ((Reason.BELOW_MARGIN,), [2.3, 0.7, 3.9, 1, 2, 4]),
        *(((reason,), [1, 2, 4]) for reason in (Reason.IN_SEQUENCE, Reason.DEPENDENT, Reason.LOSSES)),
    ],
    ids=lambda value: "-".join(value) if value and isinstance(value[0], Reason) else "",
)
def test_why_nobody_is_fastest(reasons, said, sentences):
    analysis = make_analysis(Measured(FAST), Measured(FAST, **ZENOH))
    details = replace(analysis.details, answers=tuple(map(undecided, range(1, 3), reasons)))
    answer = Book(replace(analysis, details=details)).answer
    found = [text for kind, text in answer.sentences if kind is PointKind.UNDECIDED]
    sentences(*found)
    assert numbers(" ".join(found)) == said


@pytest.mark.parametrize(
    ("missed", "judged", "unsure", "said"),
    [
        pytest.param([1], [4], [0], [10, 1, 4, 25], id="one result"),
        pytest.param([0, 0], [4, 4], [0, 0], [10, 0, 8], id="none missed"),
        pytest.param([1, 2], [1, 4], [0, 0], [10, 3, 5, 60, 1, 10, 100], id="the only message of a result"),
        pytest.param([3, 2], [6, 4], [9, 0], [10, 5, 10, 50, 33, 10, 50, 9], id="unsure ones are of the messages"),
    ],
)
def test_the_deadline_in_numbers(missed, judged, unsure, said, sentences):
    analysis = make_analysis(Measured(FAST), Measured(FAST, payload_bytes=1000))
    freshness = pl.DataFrame(
        {"group": range(len(missed)), "missed": missed, "judged": judged, "unsure": unsure},
        dict.fromkeys(("group", "missed", "judged", "unsure"), pl.UInt32),
    )
    details = replace(analysis.details, freshness=freshness, deadline_ns=10 * MS)
    found = Book(replace(analysis, details=details)).answer.remarks[0]
    sentences(found)
    assert numbers(found) == said
