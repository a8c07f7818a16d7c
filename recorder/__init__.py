"""The ping and relay roles that stamp T1-T4 and hand them to a trace."""

from recorder.backend import Discovery, ExecutorKind, NodeOptions, Serialization, Transport
from recorder.cost import FloorCost, measure_floor
from recorder.durations import parse_duration
from recorder.options import DEFAULT_MESSAGES, DEFAULT_WARMUP, PingOptions, RecordOptions
from recorder.progress import PingProgress, RelayProgress, Watch
from recorder.recording import Recorded, record
from recorder.sizes import format_size, parse_size

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
    "RelayProgress",
    "Serialization",
    "Transport",
    "Watch",
    "format_size",
    "measure_floor",
    "parse_duration",
    "parse_size",
    "record",
]
