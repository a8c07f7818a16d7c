"""The contract between the devices that record and the machine that analyzes: one `.mcap` file."""

from dds_trace.tracefile.errors import (
    BackendUnavailableError,
    BridgeError,
    MissingEventsError,
    NoEchoError,
    OptionError,
    OutputError,
    OutputExistsError,
    TraceError,
    TraceFormatError,
)
from dds_trace.tracefile.format.descriptions import FORMAT_VERSION, Qos, Run, Session
from dds_trace.tracefile.format.events import (
    CDR_HEADER,
    EVENT_DTYPE,
    HOST_TOPIC,
    RUN_TOPIC,
    SESSION_TOPIC,
    EventColumns,
    Stage,
    pack_event,
    unpack_event,
)
from dds_trace.tracefile.reading.discovery import find_traces
from dds_trace.tracefile.reading.reader import (
    expected_events,
    iter_event_batches,
    read_descriptions,
    read_trace,
)
from dds_trace.tracefile.reading.trace import Trace
from dds_trace.tracefile.recovery.recover import RecoveryReport, recover
from dds_trace.tracefile.version import __version__
from dds_trace.tracefile.writing.background import run_in_background
from dds_trace.tracefile.writing.cost import RecorderCost, measure_recorder_cost
from dds_trace.tracefile.writing.sink import ClosedTrace, TraceDestination, TraceSink

__all__ = [
    "CDR_HEADER",
    "EVENT_DTYPE",
    "FORMAT_VERSION",
    "HOST_TOPIC",
    "RUN_TOPIC",
    "SESSION_TOPIC",
    "BackendUnavailableError",
    "BridgeError",
    "ClosedTrace",
    "EventColumns",
    "MissingEventsError",
    "NoEchoError",
    "OptionError",
    "OutputError",
    "OutputExistsError",
    "Qos",
    "RecorderCost",
    "RecoveryReport",
    "Run",
    "Session",
    "Stage",
    "Trace",
    "TraceDestination",
    "TraceError",
    "TraceFormatError",
    "TraceSink",
    "__version__",
    "expected_events",
    "find_traces",
    "iter_event_batches",
    "measure_recorder_cost",
    "pack_event",
    "read_descriptions",
    "read_trace",
    "recover",
    "run_in_background",
    "unpack_event",
]
