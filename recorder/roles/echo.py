"""Why an echo or a reply is missing: what a ping looked for, what it sees, and what to try."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from dds_trace.base.units import SECOND_NS, counted, format_size, spell_duration
from dds_trace.tracefile.format.descriptions import Qos

from ..applied.applied import MIN_PAYLOAD_BYTES, POSSIBLY, Applied, Traffic, tcp_delta
from ..applied.differences import Difference, Setting
from ..applied.memory import SHM, ports_of_others
from ..backends import load_backend, load_backends
from ..backends.node import Endpoint, Node, NodeOptions
from ..backends.qos import requested_durations
from ..choices import Call, Discovery, Security, Transport
from ..domains import domain_port_range
from ..errors import RelayLostError
from ..payloads import data_types
from ..payloads.base import DataType
from .plan import RunPlan
from .progress import Silence


@dataclass(frozen=True, slots=True)
class RelayView:
    """The relays' endpoints that a ping sees: subscriptions on its topic, publishers of replies.

    `incompatible` has a line for each pair that never matches by quality of service, `unassignable` for each side with
    another type definition.
    """

    subscriptions: tuple[Endpoint, ...]
    publishers: tuple[Endpoint, ...]
    incompatible: tuple[str, ...]
    unassignable: tuple[str, ...] = ()

    @property
    def is_hopeless(self) -> bool:
        hopeless = len(self.incompatible)
        return hopeless > 0 and hopeless >= max(len(self.subscriptions), len(self.publishers))


def look_for_relays(node: Node, data_type: DataType) -> RelayView:
    there, back = node.look_at(data_type.topic), node.look_at(data_type.relay_topic)
    own_name = node.options.name
    return RelayView(
        tuple(endpoint for endpoint in there.subscriptions if endpoint.node_name != own_name),
        tuple(endpoint for endpoint in back.publishers if endpoint.node_name != own_name),
        there.incompatible + back.incompatible,
        there.unassignable + back.unassignable,
    )


def find_loss(
    node: Node, data_type: DataType, silence: Silence, *, ended: bool, patience_s: float = 0.0
) -> RelayLostError | None:
    """Return the error of a lost relay: during the run one that is not visible, and silent for `patience_s`."""
    if not silence.is_lasting:
        return None
    if not ended and (silence.duration_ns < patience_s * SECOND_NS or look_for_relays(node, data_type).publishers):
        return None
    return RelayLostError(
        f"the relay of {data_type.topic} is lost: no reply to the last {counted(silence.messages, 'message')} "
        f"({silence.duration_ns / SECOND_NS:.1f} s); check the last output of the relay, and the link to it"
    )


def printed(error: str) -> str:
    return f'the middleware printed "{error}"'


def own_causes(probes: Traffic, applied: Applied, error: str) -> Iterator[str]:
    """Yield what a ping saw of its own probes: `error` is what the middleware printed, `applied` is from its start on."""
    if error:
        yield printed(error)
    if dropped := applied.socket_drops():
        yield f"the kernel dropped {counted(dropped, 'datagram')} at this process's full sockets: try --tuned or a smaller --size"
    carried = tcp_delta(applied)
    if carried and probes.sent_bytes >= MIN_PAYLOAD_BYTES and carried.sent_bytes < POSSIBLY * probes.sent_bytes:
        yield (
            f"of {probes.sent_bytes / 1e6:.3g} MB that this process sent, its connections carried "
            f"{carried.sent_bytes / 1e6:.3g} MB: the sender dropped the rest, or still has it; try a smaller --size"
        )


def explain_silence(
    node: Node,
    plan: RunPlan,
    waited_s: float,
    not_applied: tuple[Difference, ...] = (),
    causes: Iterable[str] = (),
    own: Iterable[str] = (),
) -> str:
    options, middleware, data_type = node.options, node.middleware, plan.payload.data_type
    view = look_for_relays(node, data_type)
    if not view.subscriptions and not view.publishers:  # connections and shared memory need a peer
        not_applied = tuple(difference for difference in not_applied if not difference.applied.startswith("no "))
    through = "" if plan.bridge == "none" else f", through the bridge {plan.bridge} to domain {plan.relay_domain_id}"
    unlike = node.explain_security()
    where = f", at {', '.join(options.peers)}" if options.peers else ""
    saw = [
        f"{node.describe_others()} in domain {options.domain_id}",
        f"{_listed(view.subscriptions)} subscribed to {data_type.topic}",
        f"{_listed(view.publishers)} publishing {data_type.relay_topic}",
        *view.incompatible,
        *view.unassignable,
        *([unlike] if unlike else []),
        *(counted(number, kind) for kind, number in node.strangers.counts.items()),
    ]
    return (
        f"no echo within {waited_s:g} s\n"
        f"  looked for: a relay of {data_type.topic} ({data_type.type_name}) in domain {options.domain_id}{through}; "
        f"middleware {middleware.rmw or middleware.vendor}, discovery range {options.discovery.value}"
        f"{' (this device only)' if options.discovery is Discovery.LOCALHOST else ''}{where}\n"
        f"  saw: {'; '.join(saw)}\n"
        "  try: "
        + "\n  then: ".join([*own, _SAME_SECURITY if unlike else _advice(view, node, plan, not_applied, causes)])
        + ("\n  not applied: " + "; ".join(difference.words for difference in not_applied) if not_applied else "")
    )


def unexpected_relays(answering: int, discovered: int, requested: int) -> Iterator[str]:
    if answering < discovered:
        yield f"{answering} of {discovered} discovered relays answer"
    elif answering > requested:
        yield f"{answering} relays answer, and the result will be of all of them: end the others, or give -o relays={answering}"


_SAME_SECURITY = "give ping and relay the same -o security and -o keys"


def _advice(
    view: RelayView, node: Node, plan: RunPlan, not_applied: tuple[Difference, ...], causes: Iterable[str]
) -> str:
    data_type = plan.payload.data_type
    if view.incompatible:
        return "give ping and relay the same --reliability, -o durability and -o deadline"
    if view.unassignable:
        return (
            f"install the same version of {data_type.type_name.split('/')[0]} on both sides: their definitions of "
            f"{data_type.type_name} differ, so one cannot read the other's messages"
        )
    types = {endpoint.type_name for endpoint in view.subscriptions} - {data_type.type_name, ""}
    if types:
        return f"another program uses {data_type.topic} with {', '.join(sorted(types))}; stop it"
    if any(difference.setting is Setting.MEMORY_NAMESPACE for difference in not_applied):
        return (
            "let both sides have one /dev/shm (containers: --ipc=host, or one volume at /dev/shm), or give both "
            "-o transport=udp"
        )
    if view.subscriptions and plan.bridge == "none":  # else they are the bridge's
        return _advice_unheard(node, plan.payload.payload_bytes, causes)
    options, backend = node.options, node.middleware.backend
    domain_id = options.domain_id if plan.relay_domain_id is None else plan.relay_domain_id
    further = f"-o flow={data_type.flow} " if data_type.flow else ""
    further += "" if data_type.name in data_types() else f"--type {data_type.type_name} "
    dds_backends = ", ".join(entry.name for entry in load_backends() if entry.speaks_dds)
    meeting = load_backend(backend).describe_meeting(domain_id, dds_backends)
    reached = (
        f"the bridge {plan.bridge} does not reach it: a bridge of two halves needs its other half next to the relay"
    )
    crossing = "" if plan.bridge == "none" else f"; {'; '.join([*causes, f'or {reached}'])}"
    return (
        f"start `dds-trace record relay --backend {backend} --domain {domain_id} --discovery {options.discovery.value} "
        f"{_meeting_options(options)}{further}--out relay.mcap`; if it runs, check that {meeting}{crossing}"
    )


_MANY_FRAGMENTS_BYTES = 1_000_000
"""About 700 frames of Ethernet: the loss of one loses the message."""


def _advice_unheard(node: Node, size_bytes: int, seen_causes: Iterable[str]) -> str:
    others = ports_of_others(domain_port_range(node.options.domain_id))
    if others and node.middleware.vendor == "fastdds" and node.options.transport is not Transport.UDP:
        name, uid = next(iter(others.items()))
        return (
            f"{SHM / name} belongs to user {uid} and this process to user {os.geteuid()}, and Fast DDS's shared memory is only "
            "open to its owner: run both as one user, or give both -o transport=udp"
        )
    causes = list(seen_causes)
    if size_bytes >= _MANY_FRAGMENTS_BYTES and node.options.qos.reliability == "best_effort":
        causes.append(
            f"{format_size(size_bytes)} with best_effort is lost with any of its fragments, and a sender drops what the link does "
            "not take in time: try --reliability reliable or a smaller --size"
        )
    causes.append(
        "look at errors of the middleware above, and in the relay's output; try a smaller --size or a longer -o wait"
    )
    return f"a relay is there but messages do not get through: {'; '.join(causes)}; check firewalls between the devices"


def _meeting_options(options: NodeOptions) -> str:
    usual, durations = Qos(), requested_durations(options.qos)
    is_secured = options.security is not Security.OFF
    requested = {
        "rmw": options.rmw or "",
        "call": "" if options.call is Call.NONE else options.call.value,
        "transport": "" if options.transport is Transport.DEFAULT else options.transport.value,
        **{
            policy: value
            for policy in ("reliability", "durability")
            if (value := str(getattr(options.qos, policy))) != getattr(usual, policy)
        },
        "security": options.security.value if is_secured else "",
        "keys": shlex.quote(str(options.keys)) if is_secured else "",
        "deadline": spell_duration(durations["deadline"], digits=9) if "deadline" in durations else "",
    }
    return "".join(
        f"--{name} {value} " if name in ("rmw", "reliability") else f"-o {name}={value} "
        for name, value in requested.items()
        if value
    )


def _listed(endpoints: tuple[Endpoint, ...]) -> str:
    names = sorted({f"{endpoint.node_name or 'unnamed'} ({endpoint.type_name})" for endpoint in endpoints})
    return ", ".join(names) or "nobody"
