"""The contract between the devices that record and the machine that analyzes: one `.mcap` file."""

from typing import TYPE_CHECKING

from dds_trace.lazy import contents_page

if TYPE_CHECKING:
    from .errors import (
        BackendUnavailableError,
        BridgeError,
        LossesError,
        MissingEventsError,
        NoEchoError,
        NotAppliedError,
        OptionError,
        OutputError,
        OutputExistsError,
        RelayLostError,
        StoppedError,
        TraceError,
        TraceFormatError,
    )
    from .format.descriptions import Qos, Run, Session
    from .format.events import (
        EVENT_DTYPE,
        HOST_TOPIC,
        RUN_TOPIC,
        SESSION_TOPIC,
        EventColumns,
        Stage,
    )
    from .format.json_fields import FORMAT_VERSION, Json, JsonObject
    from .format.string_cdr import CDR_HEADER
    from .format.wire import WIRE_TOPIC
    from .reading.reader import iter_event_batches, read_trace, read_trace_in_pieces
    from .reading.storage import find_traces
    from .reading.trace import Trace
    from .recovery.recover import RecoveryReport, recover
    from .threads import Turn, run_in_background
    from .version import __version__
    from .writing.destination import ClosedTrace, TraceDestination
    from .writing.packing import ExpectedPair
    from .writing.sink import TraceSink
else:
    __getattr__, __dir__ = contents_page(__name__)

__all__ = [
    "CDR_HEADER",
    "EVENT_DTYPE",
    "FORMAT_VERSION",
    "HOST_TOPIC",
    "RUN_TOPIC",
    "SESSION_TOPIC",
    "WIRE_TOPIC",
    "BackendUnavailableError",
    "BridgeError",
    "ClosedTrace",
    "EventColumns",
    "ExpectedPair",
    "Json",
    "JsonObject",
    "LossesError",
    "MissingEventsError",
    "NoEchoError",
    "NotAppliedError",
    "OptionError",
    "OutputError",
    "OutputExistsError",
    "Qos",
    "RecoveryReport",
    "RelayLostError",
    "Run",
    "Session",
    "Stage",
    "StoppedError",
    "Trace",
    "TraceDestination",
    "TraceError",
    "TraceFormatError",
    "TraceSink",
    "Turn",
    "__version__",
    "find_traces",
    "iter_event_batches",
    "read_trace",
    "read_trace_in_pieces",
    "recover",
    "run_in_background",
]
