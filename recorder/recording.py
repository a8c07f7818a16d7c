"""`record`: one recording from its options to a closed trace."""

from __future__ import annotations

import gc
import math
import secrets
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from dds_trace.base import limits
from dds_trace.base.extension import load as load_part
from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.json_fields import JsonObject

from .applied.applied import Applied, Snapshot, read_applied
from .applied.differences import Difference
from .backends import load_backend
from .backends.node import Node
from .backends.qos import warn_of_depth
from .base_recording import LOOK_S, BaseRecording, Leave, Recorded
from .choices import Call, Discovery, Load
from .domains import check_domain, check_domain_id
from .errors import BridgeError, NoEchoError, RelayLostError, StoppedError
from .host.environment import kept_output
from .host.process import parse_cpus
from .options import ACTION_GOAL_BYTES, PingOptions, RecordOptions
from .payloads import is_live, open_payload, served_data_types
from .payloads.base import DataType
from .payloads.binary import BINARY
from .roles.echo import explain_silence, find_loss, look_for_relays, own_causes, printed, unexpected_relays
from .roles.further_nodes import further_nodes
from .roles.own_look import look_at_self
from .roles.ping import LONGEST_SETTLE_NS, AnyPing, PingThread, open_ping
from .roles.plan import check_rate, check_serialization, plan_run
from .roles.progress import Watch
from .roles.relay import Relay
from .security.keys import opened_keys

SERVING = "serves domain"
"""In the note of a relay that has started, for which a sweep waits."""
WIRE_LOOKS = 4
"""After as many checks without a message a relay writes the counts of its capture."""
QUIET_LOOKS = 10
"""After as many checks without a message a relay collects garbage, and one that nothing reached looks at itself."""
HOPELESS_S = 2.6
"""Wait for an echo where QoS can never match; not in step with Fast DDS's 3 s retry."""
MAX_RATE_RING_SLOTS = 1 << 19
"""Events that wait for the disk at `--rate max`, several seconds of them."""
ALL_RELAYS_S = 3.0


def record(
    options: RecordOptions, stop: threading.Event, watch: Watch, *, rehearses: bool = False, leave: Leave = nullcontext
) -> Recorded:
    """Record in the role of the options until it is done or `stop` is set.

    The trace is closed first. Then the middleware is left in the context `leave`, as it may never return.

    Raises:
        OptionError: an option makes no sense, or not on this machine.
        BackendUnavailableError: the middleware or the bridge is not on this machine.
        NoEchoError: no relay answered.
        NotAppliedError: the middleware does not use a requested setting, under `strict`.
        OutputExistsError: there is a trace already.
        OutputError: the trace cannot be written.
    """
    options.check()
    for warning in check_domain(options.node.domain_id):
        watch.note(warning)
    # Only a ping, which knows where the messages go, sends a load of the network.
    to = options.load_to or next(iter(options.node.peers), "127.0.0.1").partition(":")[0] if options.ping else None
    load: AbstractContextManager[Any] = nullcontext()
    if options.load is not Load.NONE and not rehearses:
        is_relay = not (options.ping or options.tap or options.beacon_rate_hz)
        load = load_part("parts", "load")(options.load.value, to, is_relay=is_relay)
    with opened_keys(options.node.security, options.node.keys) as keys, load as machine_load:
        options = replace(options, node=replace(options.node, keys=keys))
        if options.ping is not None and options.ping.rate_hz == math.inf:
            options = replace(options, destination=replace(options.destination, ring_slots=MAX_RATE_RING_SLOTS))
        kind: type[BaseRecording] = RelayRecording
        if options.ping is not None:
            kind = PingRecording
        elif options.tap is not None:
            kind = load_part("roles", "tap")
        elif options.beacon_rate_hz is not None:
            kind = load_part("roles", "beacon")
        return kind(options, stop, watch, rehearses=rehearses, load=machine_load, leave=leave).record()


class RelayRecording(BaseRecording):
    ROLE = "relay"
    HAS_FLOOR = True
    role: Relay

    def prepare(self, stack: ExitStack) -> None:
        served = served_data_types(self.options.types)
        self._data_types = tuple(kind.in_flow(flow) for flow in self.options.flows for kind in served) or served
        check_serialization(self._data_types, self.options.serialization)
        super().prepare(stack)

    def begin(self, stack: ExitStack) -> None:
        self.role = Relay(
            self.node,
            self.upkeep.sink,
            self.relay_id,
            data_types=self._data_types,
            qos=self.options.node.qos,
            serialization=self.options.serialization,
            on_probe=self._on_probe,
        )
        self._quiet = self._relayed = 0
        self._unmatched: set[str] = set()
        self._causes: list[str] = []
        self._is_reached = False
        self._output = stack.enter_context(ExitStack())
        self._read_error: Callable[[], str] = str if self.rehearses else self._output.enter_context(kept_output())
        self.wire.begin()
        self.node.start()
        if not self.rehearses:
            node = self.options.node
            where = ", on this device only," if node.discovery is Discovery.LOCALHOST else ""
            self.watch.note(f"relay {self.relay_id:08x} {SERVING} {node.domain_id}{where} until it is stopped")

    def _on_probe(self) -> None:
        self._is_reached = True
        if self.load:
            self.load.begin()
        self.read_back.read_begin()

    def look(self) -> None:
        super().look()
        relayed = self.role.progress().relayed
        self._quiet = self._quiet + 1 if relayed == self._relayed else 0
        self._relayed = relayed
        self._is_reached |= relayed > 0
        error = self._read_error()
        if error or self._is_reached:
            self._output.close()
            self._read_error = str
        self._report([printed(error)] if error and not self._is_reached else [])
        if self._quiet % WIRE_LOOKS == WIRE_LOOKS - 1:
            self.write_wire(go_on=True)
        if self._quiet % QUIET_LOOKS == QUIET_LOOKS - 1:
            gc.collect()
            lines = {line for topic in self.role.topics for line in self.node.look_at(topic).incompatible}
            for line in sorted(lines - self._unmatched):
                self.watch.note(f"these will never match: {line}")
            self._unmatched |= lines
            is_first = self._quiet == QUIET_LOOKS - 1 and not self._is_reached
            self._report(look_at_self(self.node) if is_first else [])

    def _report(self, causes: Iterable[str]) -> None:
        for cause in causes:
            self._causes.append(cause)
            self.watch.note(f"nothing reached this relay yet: {cause}")
            self.upkeep.report(self._causes)

    def write_wire(self, *, go_on: bool = False) -> None:
        self.wire.write_relay(self.role.progress().relayed, self.session_id, self.upkeep.sink, go_on=go_on)


class PingRecording(BaseRecording):
    ROLE = "ping"
    HAS_FLOOR = True
    role: AnyPing
    run: Run

    def __init__(self, options: RecordOptions, *more: object, **keywords: object) -> None:
        super().__init__(options, *more, **keywords)  # type: ignore[arg-type]
        assert options.ping is not None
        self._ping_options: PingOptions = options.ping

    def prepare(self, stack: ExitStack) -> None:
        ping_options, options = self._ping_options, self.options
        seed = secrets.randbits(32) if ping_options.seed is None else ping_options.seed
        size_bytes = ACTION_GOAL_BYTES if options.node.call is Call.ACTION else ping_options.size_bytes
        open_source = partial(self.open_node, "source")
        payload = stack.enter_context(
            open_payload(
                ping_options.data, size_bytes, seed, open_node=open_source, wait_s=ping_options.wait_s, stop=self.stop
            )
        )
        for note in payload.notes:
            self.watch.note(note)
        for flow in options.flows:
            payload = payload.in_flow(flow)
        self._plan = plan = plan_run(options, ping_options, payload, session_id=self.session_id, seed=seed)
        if load_backend(options.backend).speaks_dds:
            warning = warn_of_depth(plan.qos.history, plan.qos.depth, plan.rate_hz)
            if warning is not None:
                self.watch.note(warning)
        self.measure_costs(min(plan.rate_hz, limits.RATE_HZ.high))

    def meet(self, stack: ExitStack) -> bool:
        self.role = open_ping(self.node, self._plan, self.clock)
        with kept_output() as read_error:
            self.node.start()
            asked = _check_bridge(self.options, self._ping_options, self._plan.payload.data_type)
            if asked is not None:
                self.bridge = stack.enter_context(load_part("parts", "open_bridge")(self._ping_options.bridge, asked))
            if self._ping_options.nodes:
                self.costs["nodes"] = stack.enter_context(further_nodes(self.node, self._ping_options.nodes))
            if self.rehearses:  # there is no connection to read applied settings from
                return False
            self._wait_for_echo(read_error)
        self.read_back.read_begin()
        if self.bridge is not None:
            self.read_back.note_bridge(self.bridge.read_applied())
        self.read_back.report()
        return not self.stop.is_set()  # a file without a message would block the next try

    def _wait_for_echo(self, read_error: Callable[[], str]) -> None:
        ping, node, ping_options, bridge = self.role, self.node, self._ping_options, self.bridge
        self._causes: tuple[str, ...] = ()
        data_type = self._plan.payload.data_type
        self.watch.note(f"waiting for an echo of {data_type.topic} in domain {node.options.domain_id}")
        has_echo, waited_s = False, 0.0
        not_applied: tuple[Difference, ...] = ()
        while not has_echo and waited_s < ping_options.wait_s and not self.stop.is_set() and node.error is None:
            slice_s = min(HOPELESS_S, ping_options.wait_s - waited_s)
            has_echo = self._probe(slice_s, ping_options.wait_s - waited_s, ping_options.relays)
            waited_s += slice_s
            self.raise_error_of_node()
            if bridge is not None:
                bridge.check()
            if not has_echo:  # each time: after 20 s Fast DDS has forgotten an unreachable side
                not_applied = self.read_back.explain(ping.probes) or not_applied
            if look_for_relays(node, data_type).is_hopeless:
                break
        if not has_echo and not self.stop.is_set():
            answers = f"{ping.echoing_relays} of {ping_options.relays} relays answer; " if ping.echoing_relays else ""
            causes = own_causes(ping.probes, read_applied(Applied(Snapshot(sockets=()))), read_error())
            domain_id = node.options.domain_id if ping.plan.relay_domain_id is None else ping.plan.relay_domain_id
            own = (*(self._causes or look_at_self(node)), *load_part("parts", "causes_of_relays")(domain_id))
            raise NoEchoError(answers + explain_silence(node, ping.plan, waited_s, not_applied, causes, own))
        if has_echo and bridge is not None:
            bridge.mark_ready()
        # Others may need a moment more; through a bridge they are not discovered.
        relays = len(look_for_relays(node, data_type).publishers) if ping.plan.bridge == "none" else 1
        if has_echo:
            self._probe(ALL_RELAYS_S, ALL_RELAYS_S, relays)
            for text in unexpected_relays(ping.echoing_relays, relays, ping_options.relays):
                self.watch.note(text)

    def _probe(self, seconds: float, most_s: float, relays: int) -> bool:
        """Wait for echoes; give up if the middleware does not take a probe within `most_s`, or after a stop."""
        ping = self.role
        thread = PingThread(ping, lambda *_: ping.wait_for_echo(seconds, self.stop, relays), self.node.stop_receiving)
        until_s = time.monotonic() + most_s + LONGEST_SETTLE_NS / 1e9
        while not thread.wait(LOOK_S):
            if self.stop.is_set() or time.monotonic() > until_s:
                self._causes = self._causes or tuple(
                    look_at_self(self.node)
                )  # what interrupts the thread closes connections
                thread.hopeless.set()
        return bool(thread.result())

    def begin(self, stack: ExitStack) -> None:  # noqa: ARG002 - the node closes its endpoints
        self.wire.begin(self.role.run_id)
        start_at_s = self._ping_options.start_at_s
        if start_at_s is not None:
            self.stop.wait(max(0.0, start_at_s - time.time()))

    def look_until_done(self) -> None:
        ping, patience_s = self.role, self._ping_options.patience_s
        self._thread = thread = PingThread(
            ping, partial(ping.run, self.upkeep.sink), self.node.stop_receiving, patience_s
        )
        self.run = self.look_until_pinged(thread) or ping.finish(self.upkeep.sink)
        self.raise_error_of_node()
        self.error = self.error or thread.stuck or self.upkeep.shortage or self._find_failure()

    def look(self) -> None:
        self.error = self.error or self._find_failure(self._ping_options.patience_s) or self._thread.stuck
        super().look()
        if self.upkeep.shortage is not None:
            self._thread.enough.set()

    def _find_failure(self, patience_s: float | None = None) -> BridgeError | RelayLostError | None:
        if self.bridge is not None:
            try:
                self.bridge.check()
            except BridgeError as died:
                return died
        data_type, silence = self._plan.payload.data_type, self.role.silence
        return find_loss(self.node, data_type, silence, ended=patience_s is None, patience_s=patience_s or 0.0)

    def write_wire(self) -> None:
        self.run = self.wire.write_run(self.run, self.upkeep.sink)

    def close(self) -> JsonObject:
        described: JsonObject = {"error": None if self.error is None else str(self.error)}
        if self.bridge is None:
            return described
        self.read_back.note_bridge(self.bridge.read_applied())
        self.bridge.stop()  # its description then says how it ended
        return {**described, "bridge": self.bridge.describe()}


def rehearse(options: RecordOptions, watch: Watch) -> None:
    """Start a recording and end it before its first message; errors as for `record`. The other side, network and disk are not tested."""
    check_options(options)
    with tempfile.TemporaryDirectory(prefix="dds-trace-rehearsal-") as folder:
        scratch = replace(options.destination, path=Path(folder) / options.destination.path.name)
        record(replace(options, destination=scratch), threading.Event(), watch, rehearses=True)


def check_options(options: RecordOptions) -> None:
    """Check the options, and that the data exists, without opening a node; errors as for `record`."""
    options.check()
    check_domain_id(options.node.domain_id)
    load_backend(options.backend).check(options.node)
    if options.cpu_affinity is not None:
        parse_cpus(options.cpu_affinity)
    if options.ping is None:
        check_serialization(served_data_types(options.types), options.serialization)
    else:
        _check_data(options.ping)
        _check_bridge(options, options.ping, BINARY)


def _check_bridge(options: RecordOptions, ping: PingOptions, data_type: DataType) -> object | None:
    return None if ping.bridge == "none" else load_part("parts", "check_bridge")(options, ping, data_type)


def _check_data(ping: PingOptions) -> None:
    if is_live(ping.data):
        check_rate(ping, is_live=True)
        return
    stop = threading.Event()
    stop.set()  # makes no payload after the checks
    with suppress(StoppedError), open_payload(ping.data, ping.size_bytes, 0, open_node=_no_node, wait_s=0.0, stop=stop):
        pass


def _no_node() -> Node:
    raise AssertionError("only a live topic opens a node")
