"""From what is asked and the data at hand to the plan of a run: rate and count follow the data where nothing is said."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

from ..options import DEFAULT_MESSAGES, DEFAULT_RATE_HZ
from .ping import RunPlan

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ..backends.base import Serialization
    from ..options import PingOptions, RecordOptions
    from ..payloads.base import DataType, Payload


def plan_run(
    options: RecordOptions, asked: PingOptions, payload: Payload, *, session_id: int, seed: int
) -> RunPlan:
    """The run that `asked` means with this payload.

    Raises:
        OptionError: the payload cannot be sent like this.
    """
    check_serialization([payload.data_type], options.serialization)
    if payload.feed is not None and asked.rate_hz is not None:
        raise OptionError("--rate cannot be given with topic:/NAME, whose messages are the schedule")
    rate_hz = asked.rate_hz or payload.rate_hz or DEFAULT_RATE_HZ
    own_domain_id = options.node.domain_id
    source = {"data_source": payload.source} if payload.source else {"seed": seed}
    running = {"bridge_running": True} if asked.bridge_running else {}
    return RunPlan(
        payload=payload,
        rate_hz=rate_hz,
        messages=count_messages(asked.messages, options.duration_s, rate_hz, asked.warmup),
        warmup=asked.warmup,
        qos=options.node.qos,
        serialization=options.serialization,
        bridge=asked.bridge,
        relay_domain_id=own_domain_id if asked.relay_domain_id is None else asked.relay_domain_id,
        labels=asked.labels,
        extra={"session_id": f"{session_id:016x}", **source, **running},
    )


def count_messages(messages: int | None, duration_s: float | None, rate_hz: float, warmup: int) -> int:
    """As many as were asked for, or as fit the duration behind the warm-up."""
    if messages is not None:
        return messages
    if duration_s is None:
        return DEFAULT_MESSAGES
    return max(round(duration_s * rate_hz) - warmup, 1)


def check_serialization(data_types: Iterable[DataType], serialization: Serialization) -> None:
    """Refuse message objects of types that travel as bytes alone.

    Raises:
        OptionError: naming one of `data_types`.
    """
    for data_type in data_types:
        if serialization not in data_type.stamps:
            raise OptionError(
                f"--serialization {serialization.value}: {data_type.type_name} is sent as raw bytes alone"
            )
