from dataclasses import replace

import pytest
from campaigns import write_run
from snapshots import applied, counted, segment, tcp, udp
from trace_files import evenly, ping_session, relay_session, run, write_pair
from wording import numbers

from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.verdicts.job import make_job
from dds_trace.base.records import to_json
from dds_trace.extensions.gates.compare import CompareOptions, compare
from dds_trace.extensions.gates.gate import GateOutcome, parse_gates
from dds_trace.extensions.gates.gates import judge_gates, options_for

MS = 1_000_000
COUNT = 1000
WORDS = "asked for UDP, the bytes went through shared memory"
NOT_APPLIED = [{"setting": "transport", "asked": "udp", "applied": "shm", "words": WORDS}]


def messages(way_ns):
    return [replace(one, t2=one.t2 + one.sequence % 7) for one in evenly([way_ns] * COUNT, relay_ns=10)]


def record(folder, vendor="fastdds", way_ns=MS, *, ping=None, relay=None, number=0, **changes):
    """One run of a vendor; `ping` and `relay` are further fields of their sessions."""
    of_ping, of_relay = changes.pop("domains", (5, 5))
    write_run(
        folder / vendor,
        number,
        messages(way_ns),
        ping={"vendor": vendor, "domain_id": of_ping, "extra": ping or {}},
        relay={"device": "alpha", "vendor": vendor, "domain_id": of_relay, "extra": relay or {}},
        relay_domain_id=of_relay,
        **changes,
    )


def of_code(analysis, code):
    return [finding for finding in analysis.findings if finding.code == code]


@pytest.mark.parametrize(
    ("fields", "role"),
    [
        ({"relay": {"not_applied": NOT_APPLIED}}, "relay"),
        ({"ping": {"not_applied": NOT_APPLIED}}, "ping"),
        ({"ping": {"not_applied": NOT_APPLIED}, "relay": {"not_applied": NOT_APPLIED}}, "ping and relay"),
    ],
)
def test_a_setting_that_was_not_applied_is_an_error_of_the_group(tmp_path, fields, role):
    record(tmp_path, **fields)
    (finding,) = of_code(analyze(tmp_path), "not_applied")
    assert (finding.severity.value, finding.groups) == ("error", (0,))
    assert f"{role[0].upper()}{role[1:]}: {WORDS}." in finding.what


@pytest.mark.parametrize("listed", [[], None, "udp", [None, {"words": 3}, {"words": ""}]])
def test_no_words_are_no_finding(tmp_path, listed):
    record(tmp_path, ping={"not_applied": listed})
    assert of_code(analyze(tmp_path), "not_applied") == []


def test_a_barred_group_is_in_no_answer_and_in_no_recommendation(tmp_path):
    record(tmp_path, "fastdds", MS, ping={"not_applied": NOT_APPLIED})
    record(tmp_path, "cyclonedds", 2 * MS, number=1)
    record(tmp_path, "zenoh", 3 * MS, number=2)
    job = make_job(data="binary", size="1000", rate="10", deadline="50ms", reliability="0.99")
    analysis = analyze(tmp_path, job=replace(job, payload_bytes=analyze(tmp_path).summary["payload_bytes"][0]))
    (answer,) = analysis.details.answers
    assert [each.setting["vendor"] for each in answer.contenders] == ["cyclonedds", "zenoh"]
    candidates = analysis.details.recommendation.candidates
    assert [each.setting["vendor"] for each in candidates] == ["cyclonedds", "zenoh"]
    assert analysis.barred_groups["vendor"].to_list() == ["fastdds"]
    assert sorted(analysis.summary["vendor"]) == ["cyclonedds", "fastdds", "zenoh"]


def test_a_campaign_that_is_barred_as_a_whole_has_no_answer(tmp_path):
    record(tmp_path, ping={"not_applied": NOT_APPLIED})
    details = analyze(tmp_path).details
    assert details.answers == ()
    assert details.bridge_costs.is_empty()


@pytest.mark.parametrize("barred", [(), (0,), (1,)])
def test_a_barred_group_has_no_bridge_cost(tmp_path, barred):
    fields = [{"ping": {"not_applied": NOT_APPLIED}} if number in barred else {} for number in range(2)]
    record(tmp_path / "within", **fields[0])
    record(tmp_path / "across", number=1, bridge="builtin", domains=(5, 10), way_ns=2 * MS, **fields[1])
    assert analyze(tmp_path).details.bridge_costs.is_empty() is bool(barred)


@pytest.mark.parametrize("side", ["base", "new", None])
def test_a_gate_that_meets_a_barred_group_is_inconclusive(tmp_path, side):
    for name in ("base", "new"):
        for number in range(3):  # a gate decides from three runs on
            folder = tmp_path / name / str(number)
            of_ping = {"not_applied": NOT_APPLIED} if name == side else {}
            record(folder, way_ns=MS + (name == "new"), ping=of_ping, number=number)  # not the same recordings
    gates = parse_gates(["latency_p50 > +10%", "received_ratio < 99%"])
    base, new = (analyze(tmp_path / name, details=False) for name in ("base", "new"))
    results = judge_gates(compare(base, new, options_for(gates, CompareOptions())), gates)
    expected = GateOutcome.PASSED if side is None else GateOutcome.INCONCLUSIVE
    assert [result.outcome for result in results] == [expected] * 2
    assert all(("was not applied" in result.reason) is (side is not None) for result in results)
    assert GateOutcome.INCONCLUSIVE.exit_code == 21


def instants(begin_sockets, end_sockets, begin_counters=None, end_counters=None):
    begin, end = counted(lo=(0, 0)), counted(lo=(9, 9))
    data = to_json(applied(begin_sockets=begin_sockets, sockets=end_sockets, begin=begin, end=end))
    data["begin"]["counters"], data["end"]["counters"] = begin_counters or {}, end_counters or {}
    data["begin"]["limits"] = {"net.ipv4.ipfrag_time": 30, "net.ipv4.ipfrag_high_thresh": 4_194_304}
    return {"applied": data}


def test_drops_of_tcp_sockets_are_no_datagrams(tmp_path):
    record(tmp_path, "zenoh", relay=instants((tcp(),), (tcp(dropped=4),)))
    assert of_code(analyze(tmp_path), "udp_buffer_overflow") == []


def test_drops_of_the_own_sockets_are_found(tmp_path, sentences):
    begin, end = ((udp(7411, inode=1, dropped=5),), (udp(7411, inode=1, dropped=12), udp(1, inode=2, dropped=2)))
    record(tmp_path, relay=instants(begin, end), ping=instants(begin, begin))
    (finding,) = of_code(analyze(tmp_path), "udp_buffer_overflow")
    assert finding.where.startswith("relay on alpha")
    assert "9 datagrams" in finding.what
    sentences(finding.what)
    assert finding.groups == (0,)


@pytest.mark.parametrize(
    "held",
    [
        {},
        {"applied": None},
        {"applied": {"begin": {"sockets": None}, "end": {}}},
        {"applied": {"begin": {}, "end": None}},
    ],
)
def test_unknown_sockets_are_no_finding(tmp_path, held):
    record(tmp_path, ping=held, relay=held)
    assert of_code(analyze(tmp_path), "udp_buffer_overflow") == []


def test_lost_fragments_are_found(tmp_path, sentences):
    begin = {"ReasmFails": 5, "ReasmTimeout": 1, "FragFails": 3}
    record(
        tmp_path,
        ping=instants((), (), begin, {"ReasmFails": 25, "ReasmTimeout": 5, "FragFails": 4}),
        relay=instants((), (), begin, begin),
    )
    lost, unsent = of_code(analyze(tmp_path), "fragments_lost")
    assert numbers(lost.what) == [20, 4]
    assert {30, 4_194_304} <= {*numbers(lost.action)}
    assert numbers(unsent.what) == [1]
    assert "ipfrag" not in unsent.action
    sentences(lost.what, lost.action, unsent.what, unsent.action)


@pytest.mark.parametrize(
    ("path", "mtu", "payload_bytes", "is_blamed"),
    [
        ("eth0", {"eth0": 1500}, 33_000, True),
        ("eth0", {"eth0": 1500}, 1000, False),  # one packet holds it, so that others' datagrams failed
        ("eth0", {"eth0": 9000}, 8_000, False),
        ("lo", {"lo": 65_536}, 4_000_000, False),  # which takes the largest datagram there is
        ("shm", {}, 33_000, False),
        ("unknown", {"eth0": 1500}, 1000, False),  # whichever it was
        ("unknown", {"eth0": 1500}, 1300, True),
        (None, {}, 1100, True),  # an older recorder does not tell
    ],
)
def test_fragments_of_others_are_not_blamed_on_a_run_that_sent_none(tmp_path, path, mtu, payload_bytes, is_blamed):
    fields = instants((), (), {"ReasmFails": 5}, {"ReasmFails": 25})
    fields["applied"]["path"] = path
    host = {"mtu": mtu}
    write_pair(
        tmp_path,
        messages(MS),
        ping=ping_session(extra=fields, host=host),
        relay=relay_session(extra=fields, host=host),
        runs=[run(planned_messages=COUNT, published=COUNT, payload_bytes=payload_bytes)],
    )
    assert bool(of_code(analyze(tmp_path), "fragments_lost")) is is_blamed


@pytest.mark.parametrize(("kernel_drops", "code"), [(0, "fragments_lost"), (1, "wire_incomplete")])
def test_a_captured_run_is_judged_by_its_own_counts_alone(tmp_path, kernel_drops, code, sentences):
    counts = {"kernel_drops": kernel_drops, "ip": {"reassembly_failed": 3}}
    fields = instants((), (), {"ReasmFails": 5}, {"ReasmFails": 25})
    write_pair(
        tmp_path,
        messages(MS),
        ping=ping_session(extra=fields),
        relay=relay_session(extra=fields),
        runs=[run(planned_messages=COUNT, published=COUNT, extra={"wire": counts})],
    )
    found = [f for f in analyze(tmp_path).findings if f.code in {"fragments_lost", "wire_incomplete"}]
    assert [(f.code, f.groups) for f in found] == [(code, (0,))]
    assert "3 datagrams" in found[0].what
    sentences(found[0].what)


def test_a_count_that_began_anew_is_no_finding(tmp_path):
    record(tmp_path, ping=instants((), (), {"ReasmFails": 9}, {"ReasmFails": 2}))
    assert of_code(analyze(tmp_path), "fragments_lost") == []


def of_path(path, *, memory=(), sockets=()):
    data = to_json(applied(memory=memory, sockets=sockets, begin=counted(lo=(0, 0)), end=counted(lo=(9, 9))))
    return {"applied": {**data, "path": path}}


@pytest.mark.parametrize(
    ("fields", "cause"),
    [
        (of_path("shm"), "segment of 512 KiB"),
        (of_path("lo"), "no cause"),
        (of_path("unknown"), "no cause"),
        (of_path("unknown", memory=(segment(),)), "segment of 512 KiB"),
        (of_path("lo", sockets=(udp(7411, 300_000), udp(9))), "no cause"),
        (of_path("lo", sockets=(udp(7411, 600_000), udp(9))), "alpha (SO_RCVBUF of its UDP sockets 600 KB)"),
        ({}, "segment of 512 KiB"),
    ],
)
def test_the_cause_of_a_jump_looks_at_what_was_applied(tmp_path, fields, cause, sentences):
    for number, (size, way_ns) in enumerate([(502_000, MS), (1_000_000, 50 * MS)] * 3):
        record(tmp_path / f"{number}", way_ns=way_ns, number=number, payload_bytes=size, ping=fields, relay=fields)
    (finding,) = of_code(analyze(tmp_path), "latency_jumps_with_size")
    assert cause in finding.what
    sentences(finding.what)
