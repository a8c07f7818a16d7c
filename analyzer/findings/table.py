"""The findings of an analysis, worst first."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import polars as pl

from dds_trace.base.extension import offers

from ..model.detail_frames import Overtaking
from ..model.finding import Finding, Severity
from . import calls, clocks, groups, losses, runs, sending, sessions, shapes, sides, surroundings
from .evidence import SMALLER_DATAGRAMS, Check, Evidence
from .notes import NOTES
from .rows import RESULTS

CHECKS: tuple[Check, ...] = (
    sessions.settings_not_applied,
    sessions.RECORDINGS.error(
        "recorder_drops",
        "The recorder dropped events",
        pl.col("dropped_events") > 0,
        "The recorder dropped {dropped_events:# event}; messages that it dropped count as lost.",
        "Do not trust losses here; a faster disk, a lower rate or a larger ring may help.",
    ),
    sessions.failed_bridges,
    sessions.RECORDINGS.error(
        "ended_by_error",
        "An error ended a run before its plan",
        pl.col("error").is_not_null(),
        "The run ended before its plan, or with nobody left to answer: {error}.",
        "Messages after the failure count as lost: repeat the run.",
    ),
    sessions.RECORDINGS.error(
        "recording_stopped",
        "A relay could not record all that it sent back",
        pl.col("stopped").is_not_null(),
        "The relay could not record all that it sent back: {stopped}.",
        "Messages of that time have no T3 and T4, and count as lost on the way out if they did not come back: make room and record "
        "again.",
    ),
    runs.forged_or_foreign,
    runs.other_sizes,
    runs.UNPLACED.error(
        "undescribed_run",
        "No trace describes a run",
        pl.col("reason") == "no_run_description",
        "No trace describes these runs (topic /dds_trace/run), so their messages were left out. {events:# event}, {runs}.",
        "Keep that topic when filtering bags.",
    ),
    runs.UNPLACED.error(
        "undescribed_session",
        "No trace describes the ping's session",
        pl.col("reason") == "no_ping_session",
        "No trace describes the ping session of these runs (topic /dds_trace/session), so they were left out. {events:# event}, {runs}.",
        "Keep that topic when filtering bags.",
    ),
    runs.RUNS_OF_RESULTS.error(
        "no_relay",
        "No relay took part in a run",
        ~pl.col("took_part"),
        "No relay took part: no reply came, and no relay's trace has the run.",
        "Start the relay first, in the same domain or on the other side of the bridge, and add its trace.",
    ),
    runs.RUNS.error(
        "missing_publications",
        "Publications are missing in the trace",
        (pl.col("state") == "finished") & (pl.col("missing") > 0),
        "{missing} of {handed_over:# published message} {missing:has no T1 in the trace; it has|have no T1 in the trace; they have} no row.",
        "Use the whole trace; if it is whole, the recorder dropped events.",
        effect=1 - pl.col("with_warmup") / pl.col("handed_over"),
    ),
    runs.EMPTY_RUNS.error(  # an error, as it has no row and a gate would pass
        "unpublished_run",
        "A run published nothing",
        pl.col("state") == "finished",
        runs.NOTHING_LEFT,
        runs.SEE_WHAT_STOPPED,
    ),
    runs.RUNS.error(
        "repeated_publications",
        "A sequence number was published more than once",
        pl.col("repeated") > 0,
        "{repeated:# T1 event repeats|T1 events repeat} the sequence number of another; the first one counts.",
        "Each run needs its own random run_id, and each message its own sequence number.",
    ),
    losses.nothing_received,
    groups.impossible_times,
    clocks.TIMES_OF_TOPICS.error(
        "impossible_times",
        "Messages of a topic arrive before they are sent",
        pl.col("early") > 0,
        "{early} of {messages:# message} arrive before they are sent, beyond the bound of the clocks, by up to {least_ns:duration}.",
        "This is an error of ours, or a stamp of another clock: do not use these times, and report them with the traces.",
        pl.col("early") / pl.col("messages"),
    ),
    surroundings.LOADS.warning(
        "load_missing",
        "A load that was requested did nothing",
        ~pl.col("works"),
        "Load ({kind}) was requested, and its program used {busy:digits} processors.",
        "Do not read this result as one under load: look at what else uses the machine, and record again.",
    ),
    surroundings.LINKS.warning(
        "link_late",
        "An emulated link handed frames on later than its file says",
        (pl.col("late_ns") > 0) & (pl.col("late_ns") > surroundings.LATE_SHARE * pl.col("least_delay_ns")),
        "In a run half of the frames were handed on {late_ns:duration} late or later, where the least delay of {file} is "
        "{least_delay_ns:duration}.",
        "Its delays are longer than the file says: a free CPU or a lower rate may help, as the forwarder is a Python process.",
    ),
    runs.UNPLACED.warning(
        "orphan_relay_events",
        "The ping's trace is missing",
        pl.col("reason") == "no_ping_trace",
        "No T1 of these runs is here: the trace of their ping is missing. {events:# event}, {runs}.",
        "Copy the ping's trace into the folder, or ignore this if those runs do not matter.",
    ),
    runs.RELAYS.warning(
        "missing_relay_trace",
        "The relay's trace is missing",
        ~pl.col("relay_recorded") & ~pl.col("is_described"),
        runs.NO_EVENTS_OF_RELAY,
        "Copy the relay's trace into the folder and analyze again.",
    ),
    runs.RELAYS.warning(
        "missing_relay_trace",
        "The relay's trace lacks runs",
        ~pl.col("relay_recorded") & pl.col("is_described"),
        runs.NO_EVENTS_OF_RELAY,
        "Its trace here does not have these runs: use the whole trace, or add the one that is missing.",
    ),
    runs.RELAYS.warning(
        "undescribed_relay",
        "No trace describes the relay's session",
        pl.col("relay_recorded") & ~pl.col("is_described"),
        "{runs:# run has|runs have} events of this relay, but no session describes it: its vendor, backend and device are null.",
        "Keep the topic /dds_trace/session when filtering bags.",
    ),
    runs.EXCHANGES.warning(
        "relay_trace_gaps",
        "The relay's trace has gaps",
        pl.col("relay_recorded") & (pl.col("relay_gaps") > 0),
        "{relay_gaps} of {received:# message} ({relay_gaps:share of {received}}) came back, but the relay's trace lacks their T3 or "
        "T4: their latency is null, and lost_outbound may count messages that did arrive.",
        "Use the whole trace of the relay.",
        effect=pl.col("relay_gaps") / pl.col("received"),
    ),
    runs.RUNS_OF_RESULTS.warning(
        "unfinished_run",
        "A run has no end",
        pl.col("state") != "finished",
        "The run has no end: {with_warmup:# message was|messages were} published, {planned_messages} planned; "
        "{in_flight:# message was|messages were} under way at its end.",
        "Messages that were under way are censored: whether they would have come is unknown, so they count neither as received nor as "
        "lost. Repeat the run if that matters.",
    ),
    runs.RUNS.warning(
        "unfinished_run",
        "A run was stopped before its plan",
        runs.STOPPED_EARLY,
        "The run was stopped after {handed_over} of {planned_messages:# planned message}.",
        "Percentiles rest on fewer samples than planned; repeat the run if that matters.",
        effect=1 - pl.col("handed_over") / pl.col("planned_messages"),
    ),
    runs.EMPTY_RUNS.warning(
        "unpublished_run",
        "A run that may be going on has published nothing",
        pl.col("state") != "finished",
        runs.NOTHING_LEFT,
        runs.SEE_WHAT_STOPPED,
    ),
    runs.EXCHANGES.warning(
        "orphan_events",
        "Events name messages that were never published",
        pl.col("orphans") > 0,
        "{orphans:# T2, T3 or T4 event names a message without T1; it has|T2, T3 or T4 events name messages without T1; they have} "
        "no row.",
        "Use the whole trace of the ping; if it is whole, its recorder dropped events.",
    ),
    losses.losses,
    RESULTS.warning(
        "unreached",
        "Messages that were not to be sent back were lost",
        (pl.col("sent") > pl.col("published")) & (pl.col("reached") < pl.col("sent")),
        "{reached} of {sent:# message} ({reached:share of {sent}}) reached the relay; losses are of the {published} that it had to answer.",
        "Compare reached_rate_hz, not achieved_rate_hz; a reliable writer with -o history=keep_all waits for its reader.",
        effect=1 - pl.col("reached") / pl.col("sent"),
    ),
    losses.OUTAGES.warning(
        "outage",
        "Several messages in a row were lost",
        pl.col("times") > 0,
        "{times:# time} several messages in a row were lost, {lost} in all[; the longest lasted {longest_ns:duration}]"
        "[; {endless} lasted to the end of the run].",
        "Look at the timeline: a link that drops out, a relay that pauses, a full buffer; `loss` names what the trace shows.",
        effect=pl.col("lost") / pl.col("published"),
    ),
    losses.RECOVERIES.warning(
        "never_came_back",
        "Nothing came back after an outage that the sweep made",
        pl.col("never"),
        "After an outage of {outage_ns:duration} ({by}) no reply came within {limit_ns:duration}[, though the relay received one after "
        "{out_ns:duration}].",
        "Starting one side again after such an outage, or a setup that comes back, may help; a larger outage_limit_seconds separates "
        "slow from never.",
    ),
    losses.late_relays,
    groups.waits_in_readers,
    *runs.SEVERAL_RELAYS,
    RESULTS.warning(
        "nothing_counted",
        "All messages were warm-up",
        pl.col("published") == 0,
        "All messages were warm-up; nothing is counted.",
        "Record more messages than warm-up messages.",
    ),
    runs.doubtful_replies,
    groups.duplicates,
    RESULTS.warning(
        "reordering",
        "Replies overtook each other",
        pl.col("reordered") > 0,
        "{reordered} of {received:# reply|replies} came after the reply to a later message.",
        "With reliable QoS on one topic this should not happen: look for several routes or relays.",
        effect=pl.col("reordered") / pl.col("received"),
    ),
    sending.schedule_not_held,
    sending.stand_stills,
    sending.late_sends,
    sending.CLIENTS.warning(
        "client_bound",
        "Throughput was limited by the benchmark client",
        pl.any_horizontal(pl.col("sender_busy", "held").is_not_null()),
        "[The sending thread was busy in {sender_busy:.0%} of the time that it had a processor, {message_ns:duration} a message, in Python "
        "and the middleware; it waited for neither the middleware nor the link.]"
        "[The sender was held in {held:.0%} of its time, our relay's process took {relay_busy:.0%} of a processor: it waits for the relay.]",
        "Do not rank by this throughput: a C program (ddsperf, iperf3) sends small messages up to ten times as fast. Messages of "
        "100 KB and more may help to see the middleware's.",
        effect=pl.max_horizontal("sender_busy", "held").clip(upper_bound=1),
    ),
    runs.EXCHANGES.warning(
        "unlike_domains",
        "The relay was in another domain than the ping was given",
        pl.col("domain_of_relay") != pl.col("relay_domain"),
        "The ping was given relay domain {relay_domain}, the relay was in {domain_of_relay}, which counts.",
        "Check the options --domain and --bridge of both sides.",
    ),
    runs.RUNS.warning(
        "unlike_payloads",
        "Messages are not of the described size",
        pl.any_horizontal(pl.col("least_payload_bytes", "most_payload_bytes").ne_missing(pl.col("payload_bytes"))),
        "The run is described as {payload_bytes} B a message, its T1 events say {least_payload_bytes} to {most_payload_bytes} B; sizes "
        "and transfer rates here go by the description.",
        "Give each size a run of its own.",
    ),
    shapes.short_warm_up,
    shapes.rising_latency,
    calls.calls_timed_out,
    surroundings.disturbed_flows,
    surroundings.HEAD_OF_LINE.warning(
        "head_of_line",
        "Head-of-line blocking between flows",
        pl.col("verdict") == Overtaking.WAITS.value,
        "Of {caught:# message} of {flow} that left while one of {other} was under way and stayed so for twice the usual round trip, "
        "{overtook} returned before it[; half of them took {wait_p50_ns:duration} more than usual].",
        "They queue after it, in the middleware, in a process that takes one message at a time, or on the link: a smaller fragment, a "
        "node or a connection of its own for one of the flows, or a priority may help.",
        effect=1 - pl.col("overtook_ratio"),
    ),
    surroundings.FAN_OUT.warning(
        "slow_discovery",
        "Slow discovery: messages were lost before all relays were found",
        pl.col("matched_max_ns") > surroundings.SLOW_MATCH_NS,
        "Until the last of {receivers:# relay} answered a ping that had just started, up to {matched_max_ns:duration} passed; "
        "{missed_p50:.3g} messages to relays were lost until then (p50 of the runs)[, and discovery took {discovery_bytes_p50:,.0f} "
        "bytes].",
        "Wait for all of them before the first message that counts; a list of peers in place of multicast, or fewer participants, may "
        "help.",
        effect=1 - surroundings.SLOW_MATCH_NS / pl.col("matched_max_ns"),
    ),
    sides.overlapping_pings,
    sides.recorded_in_sequence,
    sides.dependent_passes,
    sides.unlike_versions,
    sides.mixed_versions,
    sides.wireless_on_one_machine,
    groups.mixed_labels,
    groups.unlike_group_environments,
    sessions.unlike_environments,
    sessions.RECORDINGS.warning(
        "unclosed_session",
        "A recording has no clean end",
        pl.col("state") != "closed",
        "The recording has no clean end: it was killed, lost power, or still goes on; how many events it dropped is unknown.",
        "Stop recordings with Ctrl-C or --duration and analyze again.",
    ),
    sessions.RECORDINGS.warning(
        "strangers",
        "Unexpected traffic from another process was rejected",
        pl.col("strangers") != "",
        "Others sent what was not accepted: {strangers}.",
        "Find out who else sends on this domain or port (SECURITY.md), and record where nobody does: their load is in the latency.",
    ),
    sessions.doubtful_sessions,
    clocks.STEPS.warning(
        "suspend",
        "A device was suspended",
        pl.col("slept"),
        "Its clock stood still for {lasted_ns:duration} (within {bound_ns:duration}) before {before_s:.1f} s of the ping's clock, and "
        "the relay ran on: the device, or its virtual machine, was suspended.",
        "Repeat the runs about that time with suspending switched off: messages were lost or late for it. If the stamps are not of "
        "CLOCK_MONOTONIC, that clock was set.",
    ),
    clocks.STEPS.warning(
        "clock_step",
        "A clock jumped against the other device's",
        ~pl.col("slept"),
        "The clock jumped by {size_ns:duration} (within {bound_ns:duration}) before {before_s:.1f} s of the ping's clock.",
        "One-way times are fitted separately before and after; a message under way at the jump has a wrong round trip. Do not restart "
        "devices while recording.",
    ),
    clocks.SET_CLOCKS.warning(
        "clock_set",
        "A wall clock was set",
        pl.lit(value=True),
        "The wall clock was set {way} by {size_ns:duration} {when}.",
        "Times of day before and after do not fit together; one-way times of topics are corrected, and near the step their bound includes "
        "it. Letting NTP settle before recording may help.",
    ),
    clocks.slews,
    clocks.clock_drifts,
    clocks.cpu_saturation,
    clocks.coarse_clocks,
    sessions.RECORDINGS.warning(
        "udp_buffer_overflow",
        "The recording's own sockets ran out of receive buffer",
        pl.col("dropped_datagrams") > 0,
        "The kernel dropped {dropped_datagrams:# datagram} at its own sockets, whose receive buffer was full.",
        "Expect losses and late large messages: {cure}.",
    ),
    sessions.FRAGMENTS.warning(
        "fragments_lost",
        "A host lost IP fragments while messages were under way",
        pl.col("counter") == "ReasmFails",
        "In its network namespace, all programs together, {datagrams:# datagram} could not be put together from IP fragments ({late} of "
        "them for a fragment that never came).",
        f"One lost fragment loses its whole datagram{{limits}}: {SMALLER_DATAGRAMS}.",
    ),
    sessions.FRAGMENTS.warning(
        "fragments_lost",
        "A host dropped IP fragments before they were sent",
        pl.col("counter") == "FragFails",
        "In its network namespace, all programs together, {datagrams:# datagram} could not be sent as IP fragments.",
        "The interface's queue was full: leave larger send buffers out (sendBufferSize, net.core.wmem_default), or let the queue take "
        "a whole burst (tc qdisc, txqueuelen).",
    ),
    sessions.several_networks,
    sessions.SOURCES.warning(
        "skipped_file",
        "An .mcap file was not used",
        (pl.col("status") == "skipped") & pl.col("where").str.ends_with(".mcap"),
        "Not used: {detail}.",
        "If this should be a trace, look at it with `mcap doctor`; else move it elsewhere.",
    ),
    sessions.TRACES.warning(
        "truncated_file",
        "A file ends early",
        pl.col("truncated") != "",
        "The file ends early ({truncated}); everything before that was used[, and {ring_events:# event} of its ring].",
        "Messages near the end that its ring lacks may count as lost though they were not: record again if that matters.",
    ),
    sessions.TRACES.warning(
        "unreadable_messages",
        "Messages on event topics are not events",
        pl.col("unreadable_messages") > 0,
        "{unreadable_messages:# message on an event topic is not an event and was|messages on event topics are not events and were} "
        "not used.",
        "Compare what wrote the file with docs/trace-format.md.",
    ),
    *NOTES,
)
"""In the order of findings of equal severity and effect."""

_RANK = {severity: rank for rank, severity in enumerate(Severity)}

_MOST_LISTED = 20
"""Findings of one severity and code that are listed singly."""


def all_checks(evidence: Evidence | None = None) -> Iterator[Check]:
    """Yield all checks, an extension's after the check that it names; given evidence, only those whose frames it has."""
    after: dict[str, tuple[Check, ...]] = {}
    for frame, home in offers("findings").items():
        if evidence is None or getattr(evidence.details, frame).height:
            after |= home()
    for check in CHECKS:
        yield check
        yield from after.get(check.code, ())


def find_findings(evidence: Evidence) -> tuple[Finding, ...]:
    kinds: dict[tuple[Severity, str], list[Finding]] = defaultdict(list)
    checks = [*all_checks(evidence)]
    for check in checks:
        kinds[check.severity, check.code] += check(evidence)
    listed = [finding for same in shapes.with_causes(evidence, kinds.values(), checks) for finding in _worst(same)]
    return tuple(sorted(listed, key=lambda finding: (_RANK[finding.severity], -finding.effect)))


def _worst(findings: list[Finding]) -> list[Finding]:
    findings = sorted(findings, key=lambda finding: -finding.effect)
    others = findings[_MOST_LISTED:]
    if len(others) <= 1:
        return findings
    first = others[0]
    without_worst = replace(
        first,
        where=f"{first.where}; and {len(others) - 1} more",
        what=f"{len(others)} more of this kind. {first.what}",
        groups=tuple(dict.fromkeys(group for finding in others for group in finding.groups)),
        count=len(others),
    )
    return [*findings[:_MOST_LISTED], without_worst]
