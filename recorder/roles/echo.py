"""The explanation of a missing echo or reply: what a ping looked for, what it sees, and what to try."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.base.units import SECOND_NS, counted

from ..applied.differences import Setting
from ..backends import load_backend, load_backends
from ..errors import RelayLostError
from ..payloads import data_types

if TYPE_CHECKING:
    from ..applied.differences import Difference
    from ..backends.node import Endpoint, Node
    from ..payloads.base import DataType
    from .plan import RunPlan
    from .replies import Silence


@dataclass(frozen=True, slots=True)
class Sight:
    """The endpoints of relays that a ping sees for its data type.

    Attributes:
        subscriptions: subscriptions of others on the topic of the way out.
        publishers: publishers of others on the topic of the way back.
        incompatible: one line for each pair, on both topics, whose quality of service can never match.
        unassignable: one line for each side, on both topics, whose type has the same name and another definition.
    """

    subscriptions: tuple[Endpoint, ...]
    publishers: tuple[Endpoint, ...]
    incompatible: tuple[str, ...]
    unassignable: tuple[str, ...] = ()

    @property
    def is_hopeless(self) -> bool:
        """Whether relays are in sight and none of them can ever match."""
        hopeless = len(self.incompatible)
        return hopeless > 0 and hopeless >= max(len(self.subscriptions), len(self.publishers))


def look_for_relays(node: Node, data_type: DataType) -> Sight:
    """Return the endpoints of relays of `data_type` that `node` sees now."""
    there, back = node.look_at(data_type.topic), node.look_at(data_type.relay_topic)
    own = node.options.name
    return Sight(
        tuple(endpoint for endpoint in there.subscriptions if endpoint.node_name != own),
        tuple(endpoint for endpoint in back.publishers if endpoint.node_name != own),
        there.incompatible + back.incompatible,
        there.unassignable + back.unassignable,
    )


def find_loss(node: Node, data_type: DataType, silence: Silence, *, ended: bool) -> RelayLostError | None:
    """Return the error of a relay that answers no more, None while it may still come back.

    Args:
        node: node of the ping.
        data_type: data type of its run.
        silence: messages behind the last answered one.
        ended: whether the run has ended; before, a relay is lost only once it is out of sight too, since a link that fails
            for some seconds is something to measure.
    """
    if not silence.is_lasting or (not ended and look_for_relays(node, data_type).publishers):
        return None
    return RelayLostError(
        f"the relay of {data_type.topic} is lost: no reply to the last {counted(silence.messages, 'message')} "
        f"({silence.duration_ns / SECOND_NS:.1f} s); look at what the relay said last, and at the link to it"
    )


def explain_silence(
    node: Node, plan: RunPlan, waited_s: float, not_applied: tuple[Difference, ...] = ()
) -> str:
    """Return the message of a `NoEchoError`: looked for, saw, try, and the settings that were not applied.

    Args:
        node: node of the ping.
        plan: its run.
        waited_s: time that it waited.
        not_applied: settings that the ping's process is seen not to use.
    """
    options, middleware, data_type = node.options, node.middleware, plan.payload.data_type
    sight = look_for_relays(node, data_type)
    through = (
        ""
        if plan.bridge == "none"
        else f", through the bridge {plan.bridge} to domain {plan.relay_domain_id}"
    )
    where = f", at {', '.join(options.peers)}" if options.peers else ""
    count = node.count_participants()
    others = "an unknown number of other nodes" if count is None else counted(count - 1, "other node")
    saw = [
        f"{others} in domain {options.domain_id}",
        f"{_listed(sight.subscriptions)} subscribed to {data_type.topic}",
        f"{_listed(sight.publishers)} publishing {data_type.relay_topic}",
        *sight.incompatible,
        *sight.unassignable,
    ]
    return (
        f"no echo within {waited_s:g} s\n"
        f"  looked for: a relay of {data_type.topic} ({data_type.type_name}) in domain {options.domain_id}{through}; "
        f"middleware {middleware.rmw or middleware.vendor}, discovery range {options.discovery.value}{where}\n"
        f"  saw: {'; '.join(saw)}\n"
        f"  try: {_advice(sight, node, plan, not_applied)}"
        + ("\n  not applied: " + "; ".join(each.words for each in not_applied) if not_applied else "")
    )


def _advice(sight: Sight, node: Node, plan: RunPlan, not_applied: tuple[Difference, ...]) -> str:
    data_type = plan.payload.data_type
    if sight.incompatible:
        return "give ping and relay the same --reliability, --durability and --deadline"
    if sight.unassignable:
        return (
            f"install the same version of {data_type.type_name.split('/')[0]} on both sides: their definitions of "
            f"{data_type.type_name} differ, so one cannot read the other's messages"
        )
    types = {endpoint.type_name for endpoint in sight.subscriptions} - {data_type.type_name, ""}
    if types:
        return f"another program uses {data_type.topic} with {', '.join(sorted(types))}; stop it"
    if any(each.setting is Setting.MEMORY_NAMESPACE for each in not_applied):
        return (
            "let both sides have one /dev/shm (of containers: --ipc=host, or one volume at /dev/shm), or give both "
            "--transport udp"
        )
    if sight.subscriptions:
        return (
            "a relay is in sight, so the messages do not get through: look at firewalls between the devices, try a "
            "smaller --size or a longer --wait"
        )
    options, backend = node.options, node.middleware.backend
    domain_id = options.domain_id if plan.relay_domain_id is None else plan.relay_domain_id
    further = "" if data_type.name in data_types() else f"--type {data_type.type_name} "
    dds_backends = ", ".join(each.name for each in load_backends() if each.speaks_dds)
    meeting = load_backend(backend).describe_meeting(domain_id, dds_backends)
    crossing = (
        ""
        if plan.bridge == "none"
        else f"; or the bridge {plan.bridge} does not reach it: one of two halves needs its other half beside the relay"
    )
    return (
        f"start `dds-record --role relay --backend {backend} --domain {domain_id} --discovery {options.discovery.value} "
        f"{further}--out relay.mcap`; if it runs, check that {meeting}{crossing}"
    )


def _listed(endpoints: tuple[Endpoint, ...]) -> str:
    names = sorted({f"{endpoint.node_name or 'unnamed'} ({endpoint.type_name})" for endpoint in endpoints})
    return ", ".join(names) or "nobody"
