"""The ping and relay roles that stamp T1-T4 and hand them to a trace."""

from typing import TYPE_CHECKING

from dds_trace.lazy import contents_page

if TYPE_CHECKING:
    from .backends.node import NodeOptions
    from .choices import Discovery, ExecutorKind, Serialization, Transport
    from .host.recorder_cost import RecorderCost, measure_recorder_cost
    from .options import DEFAULT_MESSAGES, DEFAULT_WARMUP, PingOptions, RecordOptions
    from .recording import Recorded, record
    from .rehearsal import check_options, rehearse
    from .roles.floor import FloorCost, measure_floor
    from .roles.progress import PingProgress, RelayProgress, Watch
else:
    __getattr__, __dir__ = contents_page(__name__)

__all__ = [
    "DEFAULT_MESSAGES",
    "DEFAULT_WARMUP",
    "Discovery",
    "ExecutorKind",
    "FloorCost",
    "NodeOptions",
    "PingOptions",
    "PingProgress",
    "RecordOptions",
    "Recorded",
    "RecorderCost",
    "RelayProgress",
    "Serialization",
    "Transport",
    "Watch",
    "check_options",
    "measure_floor",
    "measure_recorder_cost",
    "record",
    "rehearse",
]
