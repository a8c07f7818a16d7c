"""Nodes that are only there: how long after the last one was opened all are met, and what a domain of them sends at rest."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from subprocess import PIPE

import psutil

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.tracefile.format.json_fields import Json

from ..backends import load_backend
from ..backends.node import Node
from ..host.child import Child
from ..kernel.counters import read_interfaces

IN_ONE_PROCESS = 10
REST_S, PATIENCE_S = 3.0, 120.0
AT_REST = 0.9
"""Share of the packets of the seconds before, from which on they no longer become fewer."""
_PROGRAM = """
import os, sys
from contextlib import ExitStack
opened = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # a middleware prints its errors there
from dds_trace.recorder.backends import open_node
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
backend, domain, discovery, *names = sys.argv[1:]
with ExitStack() as stack:
    for name in names:
        stack.enter_context(open_node(backend, NodeOptions(int(domain), name, Discovery(discovery)))).start()
    print("open", file=opened, flush=True)
    sys.stdin.read()
"""


@contextmanager
def further_nodes(node: Node, number: int) -> Iterator[dict[str, Json]]:
    """Have so many nodes with this one, ten in a process; yield what the session records of them."""
    options, backend = node.options, node.middleware.backend
    if not load_backend(backend).speaks_dds:
        raise OptionError(f"-o nodes={number}: nodes of the backend {backend} do not discover each other; leave it out")
    names = [f"dds_trace_node_{index}" for index in range(1, number)]
    command = [sys.executable, "-c", _PROGRAM, backend, options.domain_id, options.discovery.value]
    others = node.count_participants() or 1
    with ExitStack() as stack:
        programs = [
            stack.enter_context(Child([*command, *part], stdin=PIPE, stdout=PIPE))
            for part in (names[start : start + IN_ONE_PROCESS] for start in range(0, len(names), IN_ONE_PROCESS))
        ]
        for program in programs:
            stack.callback(program.terminate)
            if not program.stdout or not program.stdout.readline():
                raise BackendUnavailableError(
                    f"-o nodes={number}: not all could be opened here (a program of {IN_ONE_PROCESS} ended with {program.wait()}); give less"
                )
        opened_s = time.monotonic()
        while (node.count_participants() or 0) < others + len(names) and time.monotonic() < opened_s + PATIENCE_S:
            time.sleep(0.01)
        are_met = (node.count_participants() or 0) >= others + len(names)
        met_s = time.monotonic() - opened_s if are_met else None
        processes = [psutil.Process(program.pid) for program in programs]
        rates = _rates_until_rest(processes, opened_s + PATIENCE_S)
        packets, size_bytes, cpu_percent = rates[-1]
        yield {
            "number": number,
            "met_s": met_s,
            "rest_s": (len(rates) - 1) * REST_S,
            "packets_per_second": round(packets),
            "bytes_per_second": round(size_bytes),
            "cpu_percent": round(cpu_percent, 1),
            "memory_bytes": sum(process.memory_info().rss for process in processes),
        }


def _rates_until_rest(processes: Sequence[psutil.Process], end_s: float) -> list[tuple[float, ...]]:
    rates = [_rates(processes)]
    while len(rates) < 2 or (rates[-1][0] < AT_REST * rates[-2][0] and time.monotonic() < end_s):
        rates.append(_rates(processes))
    return rates


def _rates(processes: Sequence[psutil.Process]) -> tuple[float, ...]:
    """Return packets and bytes a second that all interfaces sent, and the processes' share of a core in percent."""
    before, used_s = read_interfaces(), _used_s(processes)
    time.sleep(REST_S)
    sent = [(now.sent_packets - was.sent_packets, now.sent_bytes - was.sent_bytes)
            for name, now in read_interfaces().items() if (was := before.get(name))]  # fmt: skip
    totals = *map(sum, zip(*sent, strict=True)), 100 * (_used_s(processes) - used_s)
    return tuple(total / REST_S for total in totals)


def _used_s(processes: Sequence[psutil.Process]) -> float:
    return float(sum(sum(process.cpu_times()[:2]) for process in processes))  # user and system
