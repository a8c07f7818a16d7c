"""`record`: one recording from its options to a closed trace."""

from __future__ import annotations

import gc
import math
import secrets
import threading
import time
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.tracefile.writing.destination import discard

from .backends import load_backend
from .backends.qos import warn_of_depth
from .base_recording import LOOK_S, BaseRecording, Recorded, raise_error_of, sampled
from .beacon.recording import BeaconRecording
from .bridges.requested import open_requested_bridge
from .choices import Call, Load
from .domains import check_domain
from .errors import BridgeError, NoEchoError, NotAppliedError, RelayLostError
from .host.load import loaded
from .host.process import tuned_gc
from .option_values import ACTION_GOAL_BYTES
from .payloads import open_payload, served_data_types
from .roles.echo import explain_silence, find_loss, look_for_relays
from .roles.ping import open_ping
from .roles.plan import check_serialization, plan_run
from .roles.relay import Relay
from .roles.session import strangers_field
from .security.keys import opened_keys
from .service.upkeep import Upkeep
from .tap.recording import TapRecording

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from dds_trace.base.errors import OutputError
    from dds_trace.tracefile.format.descriptions import Run
    from dds_trace.tracefile.format.json_fields import JsonObject

    from .applied.differences import Difference
    from .backends.node import Node
    from .bridges.process.running import RunningBridge
    from .options import PingOptions, RecordOptions
    from .payloads.base import Payload
    from .roles.ping import AnyPing
    from .roles.plan import RunPlan
    from .roles.progress import Watch
    from .roles.read_back import ReadBack
    from .roles.wire_record import WireRecord

SERVING = "serves domain"
"""In the note of a relay that has started, for which a sweep waits."""
WIRE_LOOKS = 4
"""After as many checks without a message a relay writes the counts of its capture."""
QUIET_LOOKS = 10
"""After as many checks without a message a relay collects garbage."""
HOPELESS_S = 2.6
"""Wait for an echo where QoS can never match; not in step with Fast DDS's 3 s retry."""
MAX_RATE_RING_SLOTS = 1 << 19
"""Events that wait for the disk at `--rate max`, several seconds of them."""
ALL_RELAYS_S = 3.0
"""Longest wait for further relays after the first one has answered."""


def record(options: RecordOptions, stop: threading.Event, watch: Watch, *, rehearses: bool = False) -> Recorded:
    """Record in the role of the options until it is done or `stop` is set; `watch` receives notes and progress.

    Raises:
        OptionError: an option makes no sense, or not on this machine.
        BackendUnavailableError: the middleware or the bridge is not on this machine.
        NoEchoError: no relay answered.
        NothingHeardError: nothing came to a tap or beacon.
        NotAppliedError: the middleware does not use a requested setting, under `strict`.
        OutputExistsError: there is a trace already.
        OutputError: the trace cannot be written.
    """
    options.check()
    for warning in check_domain(options.node.domain_id):
        watch.note(warning)
    load = Load.NONE if rehearses else options.load
    # Only a ping, which knows where the messages go, sends a load of the network.
    to = options.load_to or next(iter(options.node.peers), "127.0.0.1").partition(":")[0] if options.ping else None
    with opened_keys(options.node.security, options.node.keys) as keys, loaded(load.value, to) as load_fields:
        options = replace(options, node=replace(options.node, keys=keys))
        if options.ping is not None and options.ping.rate_hz == math.inf:
            options = replace(options, destination=replace(options.destination, ring_slots=MAX_RATE_RING_SLOTS))
        if options.tap is not None:
            return TapRecording(options, stop, watch, rehearses=rehearses, load_fields=load_fields).record(options.tap)
        if options.beacon_rate_hz is not None:
            beacon = BeaconRecording(options, stop, watch, rehearses=rehearses, load_fields=load_fields)
            return beacon.record(options.beacon_rate_hz)
        recording = _Recording(options, stop, watch, rehearses=rehearses, load_fields=load_fields)
        return recording.relay() if options.ping is None else recording.ping(options.ping)


class _Recording(BaseRecording):
    def relay(self) -> Recorded:
        options = self.options
        relay_id = options.relay_id or secrets.randbits(32) or 1
        served = served_data_types(options.types)
        data_types = tuple(one.in_flow(flow) for flow in options.flows for one in served) or served
        check_serialization(data_types, options.serialization)
        self.measure_costs()
        with self.open_wire() as wire, self.open_node("relay") as node, tuned_gc():
            read_back = self.read_back(node)
            session = self.describe("relay", node, read_back, relay_id)
            with Upkeep(options, session, self.clock.monotonic_ns, self.watch.note) as upkeep:
                relay = Relay(
                    node,
                    upkeep.sink,
                    relay_id,
                    data_types=data_types,
                    qos=options.node.qos,
                    serialization=options.serialization,
                    on_probe=read_back.read_begin,
                )
                wire.begin()
                node.start()
                if self.rehearses:
                    self.stop.set()
                else:
                    self.watch.note(f"relay {relay_id:08x} {SERVING} {options.node.domain_id} until it is stopped")
                with sampled(upkeep.sink, wire):
                    self._watch_relay(relay, node, upkeep, read_back, wire)
                wire.write_relay(relay.progress().relayed, self.session_id, upkeep.sink)
                read_back.read_end(relay.traffic)
                relay.close()
                trace = upkeep.close_trace(
                    **read_back.fields(), **self.fields_at_end(), **strangers_field(node.strangers)
                )
                read_back.report(trace.path)
                return Recorded(trace, session, relay.progress(), error=upkeep.shortage)

    def ping(self, ping_options: PingOptions) -> Recorded:
        seed = secrets.randbits(32) if ping_options.seed is None else ping_options.seed
        with ExitStack() as stack:
            payload = stack.enter_context(self._open_payload(ping_options, seed))
            for note in payload.notes:
                self.watch.note(note)
            for flow in self.options.flows:
                payload = payload.in_flow(flow)
            plan = plan_run(self.options, ping_options, payload, session_id=self.session_id, seed=seed)
            self._warn_of_depth(plan)
            self.measure_costs(min(plan.rate_hz, limits.RATE_HZ.high))
            wire = stack.enter_context(self.open_wire(ping_options))
            node = stack.enter_context(self.open_node("ping"))
            ping = open_ping(node, plan, self.clock)
            node.start()
            bridge = open_requested_bridge(self.options, ping_options, payload.data_type, stack)
            read_back = self.read_back(node)
            if self.rehearses:  # there is no connection to read applied settings from
                return Recorded(None, self.describe("ping", node, read_back), ping.progress())
            self._wait_for_echo(ping, node, ping_options, bridge, read_back)
            read_back.read_begin()
            if bridge is not None:
                read_back.note_bridge(bridge.read_applied())
            read_back.report()
            session = self.describe("ping", node, read_back)
            if self.stop.is_set():  # a file without a message would block the next try
                return Recorded(None, session, ping.progress())
            upkeep = stack.enter_context(Upkeep(self.options, session, self.clock.monotonic_ns, self.watch.note))
            sink = upkeep.sink
            wire.begin(ping.run_id)
            if ping_options.start_at_s is not None:
                self.stop.wait(max(0.0, ping_options.start_at_s - time.time()))
            with sampled(sink, wire, bridge):
                run, error = self._run(ping, node, upkeep, bridge)
            run = wire.write_run(run, sink)
            read_back.read_end(ping.traffic)
            if bridge is not None:
                read_back.note_bridge(bridge.read_applied())
                bridge.stop()  # its description then says how it ended
            described: JsonObject = {"error": None if error is None else str(error)}
            if bridge is not None:
                described = {**described, "bridge": bridge.describe()}
            trace = sink.close(
                **described, **read_back.fields(), **self.fields_at_end(), **strangers_field(node.strangers)
            )
            read_back.report(trace.path)
            return Recorded(trace, session, ping.progress(), run, error)

    def _warn_of_depth(self, plan: RunPlan) -> None:
        if load_backend(self.options.backend).speaks_dds:
            warning = warn_of_depth(plan.qos.history, plan.qos.depth, plan.rate_hz)
            if warning is not None:
                self.watch.note(warning)

    def _open_payload(self, ping_options: PingOptions, seed: int) -> AbstractContextManager[Payload]:
        return open_payload(
            ping_options.data,
            ACTION_GOAL_BYTES if self.options.node.call is Call.ACTION else ping_options.size_bytes,
            seed,
            open_node=partial(self.open_node, "source"),
            wait_s=ping_options.wait_s,
            stop=self.stop,
        )

    def _wait_for_echo(
        self, ping: AnyPing, node: Node, ping_options: PingOptions, bridge: RunningBridge | None, read_back: ReadBack
    ) -> None:
        data_type = ping.plan.payload.data_type
        self.watch.note(f"waiting for an echo of {data_type.topic} in domain {node.options.domain_id}")
        has_echo, waited_s = False, 0.0
        not_applied: tuple[Difference, ...] = ()
        while not has_echo and waited_s < ping_options.wait_s and not self.stop.is_set() and node.error is None:
            slice_s = min(HOPELESS_S, ping_options.wait_s - waited_s)
            has_echo = ping.wait_for_echo(slice_s, self.stop, ping_options.relays)
            waited_s += slice_s
            raise_error_of(node)
            if bridge is not None:
                bridge.check()
            if not has_echo:  # each time: after 20 s Fast DDS has forgotten an unreachable side
                not_applied = read_back.explain(ping.probes) or not_applied
            if look_for_relays(node, data_type).is_hopeless:
                break
        if not has_echo and not self.stop.is_set():
            answers = f"{ping.echoing_relays} of {ping_options.relays} relays answer; " if ping.echoing_relays else ""
            raise NoEchoError(answers + explain_silence(node, ping.plan, waited_s, not_applied))
        if has_echo and bridge is not None:
            bridge.mark_ready()
        # Others may need a moment more; through a bridge they are not discovered.
        relays = len(look_for_relays(node, data_type).publishers) if ping.plan.bridge == "none" else 1
        if has_echo and not ping.wait_for_echo(ALL_RELAYS_S, self.stop, relays):
            self.watch.note(f"{ping.echoing_relays} of {relays} discovered relays answer")

    def _run(
        self, ping: AnyPing, node: Node, upkeep: Upkeep, bridge: RunningBridge | None
    ) -> tuple[Run, BridgeError | RelayLostError | OutputError | None]:
        """Run the ping on its own thread; return the run, and why it ended early."""
        end_ns, enough, hopeless = self.end_ns(), threading.Event(), threading.Event()
        patience_s = 0.0 if self.options.ping is None else self.options.ping.patience_s
        error: BridgeError | RelayLostError | None = None
        with ThreadPoolExecutor(1, thread_name_prefix="ping") as pool:
            future = pool.submit(ping.run, upkeep.sink, enough, hopeless)
            while not future.done():
                left_s = LOOK_S if enough.is_set() else max(self.left_s(end_ns), 0)
                wait([future], timeout=min(LOOK_S, left_s))
                error = error or _find_failure(ping, node, bridge, patience_s)
                if error is not None:
                    enough.set()
                    hopeless.set()
                self.note_disk(upkeep.sink)
                self.note_strangers(node)
                if getattr(self.stop, "is_repeated", False):
                    hopeless.set()
                progress = ping.progress()
                upkeep.look(progress.received, dict)
                is_over = self.stop.is_set() or node.error is not None or self.left_s(end_ns) <= 0
                if is_over or upkeep.shortage is not None:
                    enough.set()
                self.watch.progress(progress)
            run = future.result()
        raise_error_of(node)
        return run, error or upkeep.shortage or _find_failure(ping, node, bridge)

    def _watch_relay(self, relay: Relay, node: Node, upkeep: Upkeep, read_back: ReadBack, wire: WireRecord) -> None:
        end_ns, noted, quiet, relayed = self.end_ns(), set[str](), 0, 0
        while (left_s := self.left_s(end_ns)) > 0 and not read_back.wait(self.stop, min(LOOK_S, left_s)):
            raise_error_of(node)
            self.note_disk(upkeep.sink)
            try:
                read_back.report()
            except NotAppliedError:  # before the first message: the trace is empty
                upkeep.sink.close()
                discard(upkeep.destination)
                raise
            self.note_strangers(node)
            progress = relay.progress()
            upkeep.look(progress.relayed, read_back.fields)
            self.watch.progress(progress)
            quiet = quiet + 1 if progress.relayed == relayed else 0
            relayed = progress.relayed
            if quiet % WIRE_LOOKS == WIRE_LOOKS - 1:
                wire.write_relay(relayed, self.session_id, upkeep.sink, go_on=True)
            if quiet % QUIET_LOOKS == QUIET_LOOKS - 1:
                gc.collect()
                lines = {line for topic in relay.topics for line in node.look_at(topic).incompatible}
                for line in sorted(lines - noted):
                    self.watch.note(f"these will never match: {line}")
                noted |= lines


def _find_failure(
    ping: AnyPing, node: Node, bridge: RunningBridge | None, patience_s: float | None = None
) -> BridgeError | RelayLostError | None:
    """Return why nobody answers a ping any more, if so; without `patience_s` after its run."""
    if bridge is not None:
        try:
            bridge.check()
        except BridgeError as died:
            return died
    ended = patience_s is None
    return find_loss(node, ping.plan.payload.data_type, ping.silence, ended=ended, patience_s=patience_s or 0.0)
