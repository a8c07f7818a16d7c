from dataclasses import replace

import numpy as np
import polars as pl
from polars.testing import assert_frame_equal
from record_reader import columns
from trace_files import event, ping_session, relay_session, run

from dds_trace.analyzer.pairing.exchanges import Exchange
from dds_trace.analyzer.pairing.pair import middleware_stamps, published_messages
from dds_trace.analyzer.pairing.parquet import tables_of
from dds_trace.analyzer.pairing.roundtrips import STAMP_NAMES, pair_exchanges

RELAY = 7


def exchange(run_id, **described):
    session = relay_session(relay_id=RELAY)
    return Exchange(run(run_id=run_id, **described), ping_session(), RELAY, session, 0, 0, (1, 1, 1, 1))


def pair(exchanges, events, **options):
    """Round trips of events given as one list for each stage and run: (sequence, ns, source ns, received ns)."""
    keys = [key for each in exchanges for key in each.event_keys()]
    held = [
        columns(*(event(s, ns, scheduled_ns=ns, source_ns=a, received_ns=b) for s, ns, a, b in of_stage))
        for of_run in events
        for of_stage in of_run
    ]
    return pair_exchanges(exchanges, dict(zip(keys, held, strict=True)), **options)


def plain(*stamps):
    return [(sequence, ns, 0, 0) for sequence, ns in stamps]


def test_messages_of_unknown_fate_have_no_row():
    """Of the first run the ping was killed after T1 of 2; the second one is whole."""
    killed, whole = exchange(1, state="started"), exchange(2)
    found = pair(
        [killed, whole],
        [
            (plain((0, 10), (1, 20), (2, 30)), plain((0, 15)), plain((0, 900)), plain((0, 901))),
            (plain((0, 40), (1, 50)), plain((1, 58)), plain((0, 800), (1, 810)), plain((1, 811))),
        ],
    )
    assert found.bounds.tolist() == [0, 2, 4]
    assert found.measured.select("sequence", "publish_ns", "receive_ns", "relay_in_ns").rows() == [
        (0, 10, 15, 900),
        (1, 20, None, None),
        (0, 40, None, 800),
        (1, 50, 58, 810),
    ]
    assert found.measured["outcome"].to_list() == ["completed", "lost_outbound", "lost_in_relay", "completed"]
    assert found.counts.select("published", "received", "in_flight").rows() == [(2, 1, 1), (2, 1, 0)]
    assert found.exchange_of_row().tolist() == [0, 0, 1, 1]
    assert found.described["run_id"].to_list() == [1, 2]


def test_a_run_and_its_relay_are_alone_unless_it_is_told():
    found = pair([exchange(1)], [(plain((0, 10)), (), (), ())])
    assert found.described["setting"].to_list() == [""]


def test_one_event_tells_who_took_part():
    def told(*counts):
        one = Exchange(run(), ping_session(), RELAY, None, 0, 0, counts)
        return one.took_part, one.relay_recorded

    assert told(5, 0, 0, 0) == (False, False)
    assert told(5, 1, 0, 0) == (True, False)
    assert told(5, 0, 1, 0) == told(5, 0, 0, 1) == (True, True)


def test_texts_are_dictionaries_that_share_their_positions_where_one_holds_throughout():
    found = pair(
        [exchange(1, data_type="imu"), exchange(2)],
        [(plain((0, 10), (1, 20)), (), (), ()), (plain((0, 40)), (), (), ())],
    )
    (table,) = tables_of(replace(found, described=found.described.with_columns(rmw=pl.Series([None, "rmw_a"]))))
    assert table["data_type"].to_pylist() == ["imu", "imu", "binary"]
    assert table["rmw"].to_pylist() == [None, None, "rmw_a"]
    assert table["vendor"].to_pylist() == ["fastdds"] * 3

    def positions_at(name):
        return table[name].chunk(0).indices.buffers()[1].address

    assert positions_at("vendor") == positions_at("ping_device")
    assert len({positions_at(name) for name in ("vendor", "data_type", "rmw")}) == 3


def test_stamps_of_the_middleware_lie_beside_their_rows():
    """Arrivals of both runs have some, replies of the second alone."""
    events = [
        (plain((0, 10), (1, 20)), plain((0, 15)), [(0, 900, 3, 4)], plain((0, 901))),
        (plain((0, 40), (1, 50)), [(1, 58, 0, 6)], [(0, 800, 7, 0), (1, 810, 8, 9)], plain((1, 811))),
    ]
    found = pair([exchange(1), exchange(2)], events)
    assert {series.name: series.to_list() for series in found.stamps} == {
        "relay_source_ns": [3, 0, 7, 8],
        "relay_received_ns": [4, 0, 0, 9],
        "reply_source_ns": [0, 0, 0, 0],
        "reply_received_ns": [0, 0, 0, 6],
    }
    without = pair([exchange(1), exchange(2)], events, details=False)
    assert without.stamps == ()
    assert without.clock_knots.is_empty()
    assert without.measured["outbound_ns"].null_count() == 4


def test_exchanges_are_paired_as_each_alone():
    exchanges = [exchange(1), exchange(2), exchange(3, state="started"), exchange(4)]
    events = []
    for number in range(4):
        sent = [number * 10**12 + n * 10**7 for n in range(40)]
        events.append(
            (
                plain(*enumerate(sent)),
                [(n, ns + 900 + n % 7, 5, 6) for n, ns in enumerate(sent[:-1])],
                [(n, ns + 500 + n % 5, 7, 8) for n, ns in enumerate(sent[2:], 2)],
                plain(*((n, ns + 600) for n, ns in enumerate(sent[2:], 2))),
            )
        )
    whole = pair(exchanges, events)
    for begin, end in ((0, 4), (0, 1), (1, 3), (3, 4)):
        alone = pair(exchanges[begin:end], events[begin:end])
        first, after = whole.bounds[[begin, end]].tolist()
        assert_frame_equal(whole.measured[first:after], alone.measured)
        for name in ("described", "counts"):
            assert_frame_equal(getattr(whole, name)[begin:end], getattr(alone, name))
        knots = whole.clock_knots.filter(pl.col("group").is_between(begin, end - 1))
        assert_frame_equal(knots.with_columns(pl.col("group") - begin), alone.clock_knots)
        assert whole.outcome[first:after].tolist() == alone.outcome.tolist()
        assert whole.stamp_names == alone.stamp_names == set(STAMP_NAMES)
        for name in (*STAMP_NAMES, "sequence", "rtt_ns"):
            assert alone.column(name).name == name
            assert whole.column(name)[first:after].to_list() == alone.column(name).to_list()


def test_a_message_has_the_stamps_of_the_event_that_it_was_paired_with():
    published = published_messages(columns(event(1, 10), event(2, 20)), 0)
    replies = columns(
        event(0, 12, source_ns=1, received_ns=2),  # of no message
        event(1, 18, source_ns=3, received_ns=4),  # later than the first
        event(1, 15, source_ns=5, received_ns=6),
        event(1, 15, source_ns=7, received_ns=8),  # the same again
        event(2, 25, source_ns=0, received_ns=9),
    )
    source_ns, received_ns = middleware_stamps(published, replies, np.array([15, 25]))
    assert (source_ns.tolist(), received_ns.tolist()) == ([5, 0], [6, 9])
    only_source = columns(event(1, 15, source_ns=5))
    assert [each.tolist() for each in middleware_stamps(published, only_source, np.array([15, 25]))] == [[5, 0], [0, 0]]
    assert middleware_stamps(published, columns(event(1, 15)), np.array([15, 25])) == ()
