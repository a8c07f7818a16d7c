"""What is known of a recording before it records: its options alone, or a start that ends before the first message."""

from __future__ import annotations

import tempfile
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .backends import load_backend
from .bridges.requested import check_requested_bridge
from .domains import check_domain_id
from .errors import StoppedError
from .host.process import parse_cpus
from .payloads import is_live, open_payload, served_data_types
from .payloads.binary import BINARY
from .recording import record
from .roles.plan import check_rate, check_serialization

if TYPE_CHECKING:
    from .backends.node import Node
    from .options import PingOptions, RecordOptions
    from .roles.progress import Watch


def rehearse(options: RecordOptions, watch: Watch) -> None:
    """Start a recording as asked and end it before its first message; the trace goes to a folder that is removed again.

    Everything that a recording needs of this machine is opened: the data, the capture of the wire, the node with its
    endpoints, the bridge, the privileges. What may still fail is what surrounds it: the other side, the network, the disk.

    Raises:
        TraceError: as `record` would.
    """
    check_options(options)
    with tempfile.TemporaryDirectory(prefix="dds-trace-rehearsal-") as folder:
        elsewhere = replace(options.destination, path=Path(folder) / options.destination.path.name)
        record(replace(options, destination=elsewhere), threading.Event(), watch, rehearses=True)


def check_options(options: RecordOptions) -> None:
    """Check the options of a recording, and that its data is there, without opening a node or making a payload.

    Raises:
        OptionError: an option makes no sense, alone or beside another.
        OutputExistsError: there is a trace already.
    """
    options.check()
    check_domain_id(options.node.domain_id)
    load_backend(options.backend).check(options.node)
    if options.cpu_affinity is not None:
        parse_cpus(options.cpu_affinity)
    if options.ping is None:
        check_serialization(served_data_types(options.types), options.serialization)
    else:
        _check_data(options.ping)
        check_requested_bridge(options, options.ping, BINARY)


def _check_data(asked: PingOptions) -> None:
    """Check that the data can be found and has the asked size; a live topic is part of the surroundings.

    Raises:
        OptionError: it cannot.
    """
    if is_live(asked.data):
        check_rate(asked, is_live=True)
        return
    stop = threading.Event()
    stop.set()  # ends the making behind the checks of the size
    with (
        suppress(StoppedError),
        open_payload(asked.data, asked.size_bytes, 0, open_node=_no_node, wait_s=0.0, stop=stop),
    ):
        pass


def _no_node() -> Node:
    raise AssertionError("only a live topic opens a node")
