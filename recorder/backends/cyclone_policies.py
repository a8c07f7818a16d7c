"""Quality of service and unknown types as the Python package of Cyclone DDS has them."""

# ruff: noqa: PLC0415 - loaded with a node: other backends run without it

from __future__ import annotations

import re
from typing import Any

from dds_trace.base.errors import OptionError
from dds_trace.tracefile.format.descriptions import Qos

from ..choices import Durability, History, Reliability
from .dds_types import dds_name
from .qos import duration_extra, requested_durations

FOREVER_NS = (1 << 63) - 1


def cyclone_qos(qos: Qos, priority: int | None = None) -> Any:
    from cyclonedds.qos import Policy
    from cyclonedds.qos import Qos as CycloneQos

    values: dict[str, Any] = {
        # As in ROS 2 a writer waits for a slow reader and drops nothing.
        Reliability.RELIABLE: Policy.Reliability.Reliable(max_blocking_time=FOREVER_NS),
        Reliability.BEST_EFFORT: Policy.Reliability.BestEffort,
        Durability.VOLATILE: Policy.Durability.Volatile,
        Durability.TRANSIENT_LOCAL: Policy.Durability.TransientLocal,
        History.KEEP_LAST: Policy.History.KeepLast(qos.depth),
        History.KEEP_ALL: Policy.History.KeepAll,
    }
    try:
        policies = [values[value] for value in (qos.reliability, qos.durability, qos.history)]
    except KeyError as err:
        raise OptionError(f"Cyclone DDS has no quality of service {err}") from err
    durations = {"deadline": Policy.Deadline, "lifespan": Policy.Lifespan}
    policies += [durations[policy](duration_ns) for policy, duration_ns in requested_durations(qos).items()]
    if priority is not None:
        policies.append(Policy.TransportPriority(priority))
    if qos.durability == Durability.TRANSIENT_LOCAL:  # late readers get as much as in ROS 2
        policies.append(Policy.DurabilityService(0, values[qos.history], -1, -1, -1))
    return CycloneQos(*policies)


def qos_of(policies: Any) -> Qos:
    from cyclonedds.qos import Policy

    reliability, durability = (
        re.sub(r"(?<=[a-z])(?=[A-Z])", "_", type(policies[policy]).__name__.rpartition(".")[2]).lower()
        if policy in policies
        else ""
        for policy in (Policy.Reliability, Policy.Durability)
    )
    durations_ns = {
        policy.__scope__.lower(): getattr(policies[policy], policy.__scope__.lower())
        for policy in (Policy.Deadline, Policy.Lifespan)
        if policy in policies
    }
    return Qos(reliability, durability, "", 0, duration_extra(durations_ns))


def priority_of(writer: Any) -> int:
    from cyclonedds.qos import Policy

    qos = writer.get_qos()
    return int(qos[Policy.TransportPriority].priority) if Policy.TransportPriority in qos else 0


def opaque_type(type_name: str) -> Any:
    """Return a type of one octet: Cyclone DDS accepts what follows in a message."""
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl.types import uint8

    name = (dds_name(type_name) if type_name.count("/") == 2 else type_name).replace("::", ".")
    return make_idl_struct(name.rpartition(".")[2], name, {"octet": uint8})
