"""A verdict has its condition: what the machine did meanwhile, and how fast the messages left."""

from dataclasses import replace

import polars as pl
import pytest
from analyses import BRIDGED, MS, ZENOH, Measured, around, make_analysis
from roundtrip_frames import in_runs, rows_by_group
from wording import numbers

from dds_trace import Finding, Severity
from dds_trace.analyzer.verdicts.answers import find_answers
from dds_trace.analyzer.verdicts.judgements import DO_NOT_USE, Claim, Reason
from dds_trace.reports.book.answer import PointKind
from dds_trace.reports.book.book import Book

LOSSY = [ns if n % 5 else "lost_return" for n, ns in enumerate(3 * around(MS))]
WHOLE = 3 * around(2 * MS)


def said(book, kind):
    return " ".join(text for found, text in book.answer.sentences if found is kind)


@pytest.mark.parametrize("code", ["cpu_saturated", "stood_still", "suspend", "udp_buffer_overflow"])
@pytest.mark.parametrize("groups", [(), (0,), (0, 1)])
def test_advice_against_a_setup_names_the_busy_machine(code, groups):
    analysis = make_analysis(Measured(LOSSY, payload_bytes=1000), Measured(LOSSY), Measured(WHOLE, **ZENOH))
    finding = Finding(Severity.WARNING, code, "ping", "It was full.", "Free it.", groups=groups)
    sentence = said(Book(replace(analysis, findings=(finding,))), PointKind.AVOID)
    is_busy = bool(groups) and code != "udp_buffer_overflow"
    assert ("busy" in sentence) is is_busy
    assert sentence.count("Do not use") == (2 if is_busy and len(groups) == 1 else 1)
    assert sentence.count("20 % lost") == 2


@pytest.mark.parametrize("history", ["keep_last", "keep_all"])
@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
@pytest.mark.parametrize("side", [ZENOH, BRIDGED])
def test_at_the_highest_rate_replaced_messages_are_no_loss(history, rate_hz, side):
    analysis = make_analysis(Measured(LOSSY, rate_hz=10.0), Measured(WHOLE, rate_hz=10.0, **side))
    columns = {"rate_hz": rate_hz, "history": pl.lit(history), "transfer_rate_bytes_per_s": pl.Series([2e6, 3e6])}
    is_replaced = rate_hz == 0 and history == "keep_last"
    book = Book(replace(analysis, summary=analysis.summary.with_columns(**columns)))
    assert bool(said(book, PointKind.LOSS)) is not is_replaced
    speed = said(book, PointKind.THROUGHPUT)
    assert (0 <= speed.find("3 MB/s") < speed.find("2 MB/s")) is (rate_hz == 0)
    assert speed.count("replaced") == is_replaced, "of the one that lost some"
    assert not rate_hz or not numbers(speed)
    assert "Every message was received." not in book.answer.remarks


@pytest.mark.parametrize("history", ["keep_last", "keep_all"])
@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
def test_what_is_replaced_speaks_against_no_setup(history, rate_hz):
    lossy = [MS if n % 5 else None for n in range(200)]
    sides = {"rate_hz": rate_hz, "history": history}
    rows = pl.concat([in_runs(lossy, **sides), in_runs([2 * MS] * 200, vendor="cyclonedds", run_id=2, **sides)])
    (answer,) = find_answers(rows_by_group(rows))
    (row,) = answer.of_claim(Claim.LOSSY)
    is_replaced = rate_hz == 0 and history == "keep_last"
    assert (row.verdict == DO_NOT_USE, row.reason == Reason.REPLACED.value) == (not is_replaced, is_replaced)
    assert answer.leader_p50 == ("fastdds" if is_replaced else "")
