from dataclasses import replace

import polars as pl
import pytest
from trace_files import RUN_ID, Message, ping_events, ping_session, relay_events, relay_session, run, write_trace

from dds_trace.analyzer.groups.freshness import find_outages, late_by, runs_of
from dds_trace.analyzer.pipeline import analyze
from dds_trace.reports.book.answer import PointKind
from dds_trace.reports.book.book import Book

MS, S = 1_000_000, 1_000_000_000
BEGAN_NS, ENDED_NS = 2 * S, 5 * S


def message(sequence):
    sent = sequence * 100 * MS
    return Message(sequence, t0=sent, t1=sent, t3=sent + MS, t4=sent + MS, t2=sent + 2 * MS)


def campaign(folder, messages, limit_s=3.0):
    fields = {"run_id": RUN_ID}
    described = run(planned_messages=len(messages), published=len(messages), relay_domain_id=10)
    write_trace(folder / "ping.mcap", ping_session(), [described], ping_events(messages, **fields))
    outage = {
        "run_id": f"{RUN_ID:016x}",
        "by": "link",
        "seconds": 3.0,
        "began_ns": BEGAN_NS,
        "ended_ns": ENDED_NS,
        "limit_s": limit_s,
    }
    host = [{"monotonic_ns": ENDED_NS, "outage": outage}]
    write_trace(folder / "relay.mcap", relay_session(), (), relay_events(messages, **fields), host=host)
    return analyze(folder)


def cut(sequence):
    """Ten messages a second; those of the outage are lost but the last five, which arrive when the link has been up for 0.4 s."""
    one = message(sequence)
    if not BEGAN_NS <= one.t1 < ENDED_NS:
        return one
    if one.t1 < ENDED_NS - 500 * MS:
        return one.lost()
    back = ENDED_NS + 400 * MS
    return replace(one, t3=back, t4=back + MS, t2=back + 20 * MS)


def test_the_known_time_from_link_up_to_the_first_message_each_way_comes_back(tmp_path):
    messages = [cut(sequence) for sequence in range(80)]
    messages = [one.lost() if ENDED_NS <= one.t1 < ENDED_NS + 300 * MS else one for one in messages]
    # What leaves once the link is up overtakes nothing: it comes after what is replayed.
    later = [one for one in messages if one.t1 >= ENDED_NS + 300 * MS]
    messages = [replace(one, t3=one.t3 + S, t4=one.t4 + S, t2=one.t2 + S) if one in later else one for one in messages]
    (row,) = campaign(tmp_path, messages).details.recoveries.to_dicts()
    assert row["by"] == "link"
    assert row["outage_ns"] == 3 * S
    assert row["out_ns"] == pytest.approx(400 * MS, abs=50 * MS)
    assert row["back_ns"] == pytest.approx(420 * MS, abs=50 * MS)
    assert (row["never"], row["lost_within"], row["replayed"], row["lost_after"]) == (False, 25, 5, 3)
    assert (row["reordered"], row["duplicates"]) == (0, 0)


def test_never_is_told_from_slow_by_the_stated_limit(tmp_path, sentences):
    messages = [message(s) if message(s).t1 < BEGAN_NS else message(s).lost() for s in range(80)]
    analysis = campaign(tmp_path, messages)
    (row,) = analysis.details.recoveries.to_dicts()
    assert (row["never"], row["out_ns"], row["back_ns"]) == (True, None, None)
    (finding,) = [finding for finding in analysis.findings if finding.code == "never_came_back"]
    sentences(finding.what)


def test_a_reply_beyond_the_limit_is_never(tmp_path):
    messages = [cut(sequence) for sequence in range(80)]
    (row,) = campaign(tmp_path, messages, limit_s=0.001).details.recoveries.to_dicts()
    assert row["never"] is True
    assert row["back_ns"] == MS * 2  # the message that left at the very end


def lateness(*received_ns):
    rows = pl.LazyFrame({"exchange": 0, "received_ns": received_ns, "period_ns": 10})
    return late_by(rows).select("late_by_p50_ns", "late_by_p99_ns", "late_by_max_ns", "empty_periods").collect().rows()


def test_messages_are_late_by_what_their_gap_exceeds_the_period():
    # By 0, 0, 15, 0, 0. Loops at 0, 10 ... 60 find nothing new at 30; the message of 45 counts for the one at 50, as that of 50 does.
    assert lateness(0, 10, 20, 45, 50, 60) == [(0, pytest.approx(0.96 * 15), 15, 2)]
    assert lateness(5) == []
    assert lateness(0, 30, 20, 40) == [(10, pytest.approx(19.8), 20, 2)]  # by 20 and 0: the third was overtaken


def test_freshness_has_the_periods_of_a_control_loop_at_the_relay(tmp_path):
    messages = [message(sequence) for sequence in range(50)]
    messages[20] = replace(messages[20], t3=messages[20].t3 + 40 * MS, t4=messages[20].t4 + 40 * MS)
    (row,) = campaign(tmp_path, messages).details.freshness.to_dicts()
    assert (row["period_ns"], row["late_by_max_ns"], row["empty_periods"]) == (100 * MS, 40 * MS, 0)


def test_a_reply_before_the_stated_end_is_the_first_one(tmp_path):
    messages = [cut(sequence) for sequence in range(80)]
    early = ENDED_NS - 60 * MS
    messages[49] = replace(messages[49], t3=early, t4=early, t2=early + MS)
    (row,) = campaign(tmp_path, messages).details.recoveries.iter_rows(named=True)
    assert (row["out_ns"], row["back_ns"], row["never"]) == (0, 0, False)


def test_the_answer_begins_with_how_long_each_setup_took_to_come_back(tmp_path):
    kind, text = Book(campaign(tmp_path, [cut(sequence) for sequence in range(80)])).answer.sentences[0]
    assert kind is PointKind.RECOVERY
    assert "in 2 ms (1 run)" in text


def flags(text):
    return [character == "x" for character in text]


def messages(lost, in_time=""):
    """Messages 100, 101, 102 ... planned every 10 ns and received 4 ns later; `x` marks lost, or in time."""
    planned_ns = [10 * number for number in range(len(lost))]
    return pl.DataFrame(
        {
            "sequence": range(100, 100 + len(lost)),
            "planned_ns": planned_ns,
            "receive_ns": [time_ns + 4 for time_ns in planned_ns],
            "lost": pl.Series(flags(lost), dtype=pl.Boolean),
            "in_time": pl.Series(flags(in_time or lost), dtype=pl.Boolean),
        }
    ).with_columns(exchange=0)


def outages(lost, in_time):
    found = find_outages(messages(lost, in_time)).collect()
    return found.select("first_sequence", "messages", "start_ns", "end_ns", "recovery_ns").rows()


def test_runs_of_true_have_start_stop_and_a_longest():
    runs = runs_of(messages("xx.xxx.x"), pl.col("lost")).collect()
    assert runs.select("row", "end_row").rows() == [(0, 2), (3, 6), (7, 8)]
    assert runs["messages"].max() == 3
    for lost in ("....", ""):
        assert runs_of(messages(lost), pl.col("lost")).collect().is_empty()


def test_three_losses_in_a_row_are_an_outage_and_two_are_none():
    assert outages(lost=".xx...xxx......", in_time="x..xxx...xxxxxx") == [(106, 3, 60, 94, 0)]


def test_recovery_lasts_until_five_in_a_row_are_in_time():
    # Lost 1-3; 4 gets through at 44, late; 5 and 6 in time, 7 late, 8-12 in time: steady from 8, received at 84.
    lost, in_time = ".xxx.........", "x....xx.xxxxx"
    assert outages(lost, in_time) == [(101, 3, 10, 44, 40)]
    assert find_outages(messages(lost, in_time)).collect()["duration_ns"].to_list() == [34]


def test_an_outage_may_last_to_the_end_and_a_run_may_never_be_steady_again():
    assert outages(lost="..xxx", in_time="xx...") == [(102, 3, 20, None, None)]
    # Four in a row are too few.
    assert outages(lost="xxx....", in_time="...xxxx") == [(100, 3, 0, 34, None)]
