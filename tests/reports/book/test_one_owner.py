"""What an answer says of some results is about these results, and each number is made once."""

import random

import pytest
from analyses import MS, ZENOH, Measured, around, make_analysis
from campaigns import write_run
from trace_files import evenly
from wording import numbers

from dds_trace import Finding, Severity
from dds_trace.analyzer.pipeline import analyze
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.sizes import late_by_group
from dds_trace.reports.reporters import load_reporter


@pytest.mark.parametrize("seed", range(6))
def test_results_that_may_be_forged_leave_the_others_their_names(seed):
    chance = random.Random(seed)
    times_ns = [n * MS for n in chance.sample(range(1, 60), 8)]
    measured = [Measured(around(ns), rate_hz=5.0 + n) for n, ns in enumerate(times_ns)]
    forged = sorted(chance.sample(range(8), chance.randint(1, 7)))
    finding = Finding(
        Severity.ERROR, "forged_or_foreign", "somewhere", "2 % of the replies.", "Look.", groups=tuple(forged)
    )
    analysis = make_analysis(*measured, findings=[finding])
    book = Book(analysis, shows_all=True)
    rows = analysis.summary.with_row_index("group").to_dicts()
    rates = {row["rate_hz"]: row["latency_p50_ns"] / MS for row in rows if row["group"] not in forged}
    (remark,) = [remark for remark in book.answer.remarks if remark.startswith("Binary: median")]
    ms, _, hz = numbers(remark)[:3]
    assert rates[hz] == pytest.approx(ms, rel=0.01)
    assert all(load_reporter(kind).render(book) for kind in ("html", "md", "terminal", "json"))


@pytest.mark.parametrize("late", [0, 7])
@pytest.mark.parametrize("metric", ["response", "latency", "rtt"])
def test_a_message_that_never_left_misses_a_deadline_once(tmp_path, metric, late):
    for number, never in enumerate((3, 0, 39)):
        messages = evenly([*[MS] * (40 - late), *[30 * MS] * late], start_ns=number * 10**12)
        write_run(
            tmp_path / str(number), number, messages, planned_messages=40 + never, extra={"skipped_messages": never}
        )
    analysis = analyze(tmp_path, deadline_ns=20 * MS, deadline_metric=metric)
    assert analysis.summary["unsent"].to_list() == [42]
    missed, judged, unsure = late_by_group(analysis)[0]
    assert (missed, judged, unsure) == (42 + 3 * late, 42 + 120, 0)
    book = Book(analysis, shows_all=True)
    assert numbers(book.answer.remarks[0])[1:3] == [missed, judged]
    assert analysis.details.freshness["missed"].sum() == missed


SIDES = [{}, ZENOH, {"setting": "queue_depth=1"}]


@pytest.mark.parametrize("seed", range(4))
def test_a_relays_trace_that_is_not_there_is_no_setup_of_its_own(seed):
    chance = random.Random(seed)
    sides, missing = chance.sample(SIDES, 2), chance.choice(("pi1", "pi2"))
    measured = [
        Measured(around(chance.randint(1, 9) * MS), ping_device=pi, relay_device=None if pi == missing else "b", **side)
        for side in sides
        for pi in ("pi1", "pi2")
    ]
    book = Book(make_analysis(*measured))
    whole = Book(make_analysis(*(one for one in measured if one.relayed)))
    assert book.sizes.choices == whole.sizes.choices
    assert len(book.sizes.choices) == 2
    text = " ".join(load_reporter("md").render(book).split())
    assert "no reply has a relay" in text
    assert not {"none", "relay unknown"} & {word for label in book.sizes.choices for word in label.split(", ")}


def test_setups_of_one_message_of_which_one_has_no_relays_trace_stay_two():
    alike = [Measured(around(n * MS), relay_device=device, ping_device="b") for n, device in ((1, "b"), (2, None))]
    assert len({*Book(make_analysis(*alike)).sizes.choices}) == 2
