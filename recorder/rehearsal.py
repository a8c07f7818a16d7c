"""Checks before a recording."""

from __future__ import annotations

import tempfile
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from .backends import load_backend
from .backends.node import Node
from .bridges.requested import check_requested_bridge
from .domains import check_domain_id
from .errors import StoppedError
from .host.process import parse_cpus
from .options import PingOptions, RecordOptions
from .payloads import is_live, open_payload, served_data_types
from .payloads.binary import BINARY
from .recording import record
from .roles.plan import check_rate, check_serialization
from .roles.progress import Watch


def rehearse(options: RecordOptions, watch: Watch) -> None:
    """Start a recording and end it before its first message; errors as for `record`.

    The other side, the network and the disk are not tested.
    """
    check_options(options)
    with tempfile.TemporaryDirectory(prefix="dds-trace-rehearsal-") as folder:
        scratch = replace(options.destination, path=Path(folder) / options.destination.path.name)
        record(replace(options, destination=scratch), threading.Event(), watch, rehearses=True)


def check_options(options: RecordOptions) -> None:
    """Check the options, and that the data exists, without opening a node.

    Raises:
        OptionError: an option makes no sense, or not with the others.
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
