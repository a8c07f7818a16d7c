"""What is asked: a load between two devices, with limits; and the candidates for an answer."""

from __future__ import annotations

import json
import math
import platform
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dds_trace.analyzer.model.parameters import QOS_DEFAULTS
from dds_trace.analyzer.model.setting import write_setting
from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted, format_rate, format_size, parse_duration, parse_rate, parse_size, spell_size
from dds_trace.recorder.applied.vendors import ROS_MIDDLEWARES
from dds_trace.recorder.backends import installed_middlewares, load_backend
from dds_trace.recorder.backends.ros2 import middleware_of

from .advice import arriving_share, bundles, variables_of, write_bundles
from .halving import Candidate, Limits
from .learning.model import order
from .learning.results import read_campaigns
from .plan.cells import DEFAULTS, SENDER_AXES, Cell
from .plan.flows import MESSAGE_AXES, is_crowded, recorded_together
from .plan.link import Link
from .plan.plan import Plan
from .plan.plan_file import parse_plan, read_host, read_link

THIS_MACHINE = ("here", "localhost")
"""Names of this machine for `--host`, next to its own."""

SIZED = ("binary", "string")
"""Data that has any size."""

HOLDS = 0.9
"""Least share of datagrams that arrive whole where a setup is likely to hold."""

ROUTERS = [
    "# needs the package ros-$ROS_DISTRO-rmw-zenoh-cpp, and first on each device:",
    "#   ros2 run rmw_zenoh_cpp rmw_zenohd",
    "# with, on one of two devices, the address of the other before it:",
    """#   ZENOH_CONFIG_OVERRIDE='connect/endpoints=["tcp/OTHER:7447"]'""",
]
"""What the nodes of `rmw_zenoh_cpp` need."""

MUCH_LOSS = 1.0
"""Percent; from here on paced small packets come early."""

NOT_RECOMMENDED = ("socket",)
"""Backends that no ROS 2 node can use."""


@dataclass(frozen=True, slots=True)
class Question:
    """A plan with the messages of each middleware, what an answer has to keep, and the time to spend."""

    plan: Plan
    limits: Limits
    minutes: float = 10.0

    @property
    def messages(self) -> list[Cell]:
        return list({_message(cell): cell for cell in self.plan.cells}.values())

    @property
    def load_mbit_s(self) -> float:
        """Most payload at one time in one direction: of all flows, else of one message; without data that has its own size."""
        recordings = recorded_together(self.plan.cells)
        return max((sum(cell.payload_bit_s or 0.0 for cell in cells) for cells in recordings), default=0.0) / 1e6


def ask(
    size: str | None, rate: str, *, data: str = "binary", link: str | None = None, hosts: Sequence[str] = ()
) -> Plan:
    """Return the plan of what a person writes, with all installed middlewares; an `OptionError` names a wrong value or that none is.

    Args:
        size, rate: as `502KB`, `20`; a size of None is the data's own.
        link: name of a preset, or a file with `[link]`; both devices are then namespaces of this machine.
        hosts: the other device: an ssh name or a file with `[devices.relay]`; this machine may be named, too.
    """
    others = [host for host in hosts if host not in (*THIS_MACHINE, platform.node())]
    if link is not None and others:
        raise OptionError("--link emulates a link on this machine; remove it or --host")
    if len(others) > 1:
        raise OptionError(
            f"one of the two devices has to be this one ({platform.node()}); run the command on {others[0]}"
        )
    if size is None and data in SIZED:
        raise OptionError(f"--data {data} has no size of its own; give --size")
    size_bytes = None if size is None else parse_size(size, "--size")
    message = {"data": data, "size": size_bytes, "rate": parse_rate(rate, "--rate")}
    rows = [{"backend": backend, "rmw": rmw, **message} for backend, rmw in _middlewares()]
    texts = [
        "[[matrix]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in row.items() if value is not None)
        for row in rows
    ]
    if not texts:
        raise OptionError("no middleware is installed; `dds-trace doctor` names what to install")
    words = [
        "advice",
        data.partition(":")[0],
        *([spell_size(size_bytes)] if size_bytes else []),
        f"{message['rate']:g}Hz",
    ]
    plan = parse_plan("".join(texts), "-".join(words), "the question")
    if link is not None:
        emulated = read_link(link)
        return replace(plan, link=emulated, namespaces=True, connectivity=emulated.connectivity)
    return replace(plan, relay=read_host(others[0]), connectivity=None) if others else plan


def limits_of(deadline: str | None = None, in_time: str = "99%", cpu: float | None = None) -> Limits:
    """Return the limits of what a person writes, such as `50ms` and `99%` or `0.99`; None is no limit."""
    return Limits(
        deadline_ms=math.inf if deadline is None else parse_duration(deadline, "--deadline") / 1e6,
        late_percent=100 - _percent(in_time),
        cpu_percent=math.inf if cpu is None else cpu,
    )


def _percent(text: str) -> float:
    try:
        value = float(text.rstrip("% "))
    except ValueError:
        value = 0.0
    percent = value if text.rstrip().endswith("%") else 100 * value
    if not 50 <= percent < 100:
        raise OptionError(f"--in-time {limits.shown(text)}: write a share such as 99%, at least 50% and below 100%")
    return percent


def _middlewares() -> list[tuple[str, str | None]]:
    """Return one (backend, rmw) of each vendor, ROS 2 before the vendor's own API."""
    installed = [row for row in installed_middlewares() if row[0] not in NOT_RECOMMENDED]
    by_vendor: dict[str, tuple[str, str | None]] = {}
    for backend, rmw in sorted(installed, key=lambda row: row[0] != "ros2"):
        by_vendor.setdefault(_vendor(backend, rmw), (backend, rmw))
    return list(by_vendor.values())


def _vendor(backend: str, rmw: str | None) -> str:
    return middleware_of(rmw).vendor if backend == "ros2" else backend


def _label(cell: Cell) -> str:
    if cell.backend == "ros2":
        return f"{middleware_of(cell.rmw).label} (ROS 2)"
    return load_backend(cell.backend).label


def flows_together(plan: Plan) -> Plan:
    """Return the plan with only those results in which all of its flows are sent."""
    return replace(plan, cells=tuple(cell for cell in plan.cells if len(cell.with_flows) + 1 >= len(plan.flows)))


def _message(cell: Cell) -> tuple[object, ...]:
    return tuple(getattr(cell, axis) for axis in MESSAGE_AXES)


def check_advisable(plan: Plan) -> None:
    """Refuse plans with more than messages from one device to another."""
    faults = {
        "a relay that a person starts": plan.by_hand,
        "relays, hosts, pings and topics": any(map(is_crowded, plan.cells)),
        "flows with equal messages": any(
            len({*map(_message, cells)}) < len(cells) for cells in recorded_together(plan.cells)
        ),
        "a bridge": any(cell.crosses_domains for cell in plan.cells),
        "two middlewares in one result": any(cell.relay_backend or cell.relay_rmw for cell in plan.cells),
        "the axes configuration and tuned": any(cell.configuration or cell.tuned for cell in plan.cells),
        "rate = 'max'": any(math.isinf(cell.rate) for cell in plan.cells),
    }
    for name, is_there in faults.items():
        if is_there:
            raise OptionError(f"advise is not for {name}; remove that from the plan")


def find_candidates(plan: Plan, link: Link | None, folder: Path) -> list[Candidate]:
    """Return the candidates by their turn; the files of bundles are written to the folder."""
    setups: dict[Cell, list[Cell]] = {}
    for cell in plan.cells:
        axes = (*MESSAGE_AXES, *SENDER_AXES) if cell.flow else MESSAGE_AXES
        usual = {axis: DEFAULTS[axis] for axis in axes}
        setups.setdefault(replace(cell, **usual, flow="", with_flows=()), []).append(cell)
    largest_bytes = max((cell.size or 0 for cell in plan.cells), default=0)
    rows: list[tuple[int, Candidate]] = []
    for setup, cells in setups.items():
        vendor = _vendor(setup.backend, setup.rmw)
        # ROS 2's LOCALHOST range adds transports of its own, next to which no file counts.
        is_fixed = vendor == "fastdds" and plan.discovery == "localhost"
        texts = {} if is_fixed else bundles(vendor, largest_bytes, link)
        middleware = " ".join([_label(setup), *setup.changed_axes])
        candidates = [Candidate(middleware, vendor, "", tuple(cells), turn=1)]
        for path in write_bundles(vendor, texts, folder / vendor):
            configured = tuple(replace(cell, configuration=str(path)) for cell in cells)
            candidates.append(Candidate(middleware, vendor, path.stem, configured, path, turn=2))
        shares = [arriving_share(vendor, candidate.bundle, largest_bytes, link) for candidate in candidates]
        first = next((number for number, share in enumerate(shares) if share >= HOLDS), 0)
        candidates[first] = replace(candidates[first], turn=0)
        rows += enumerate(candidates)
        if link is not None and link.loss_percent >= MUCH_LOSS and candidates[first].bundle == "small-packets":
            rows = [
                (0, replace(row, turn=1)) if row.bundle == "paced-small-packets" else (number, row)
                for number, row in rows
            ]
    return [candidate for _, candidate in sorted(rows, key=lambda row: (row[1].turn, row[0]))]


def as_learned(plan: Plan, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates by their turn, then by what earlier campaigns took."""
    rows = []
    for candidate in candidates:
        cell, link = candidate.cells[0], plan.link_of(candidate.cells[0])
        applied = {"link": link and link.setting, "configuration": candidate.bundle}
        row = {
            **{name: getattr(cell, name, usual) for name, usual in QOS_DEFAULTS.items()},
            **{name: getattr(cell, name) for name in ("backend", "bridge")},
            **dict.fromkeys(("ping_device", "relay_device"), ""),
            "data_type": cell.data,
            "payload_bytes": cell.size or 0,
            "rate_hz": cell.rate,
            "vendor": candidate.vendor,
            "connectivity": plan.connectivity_of(cell),
            "setting": write_setting({key: text for key, text in applied.items() if text}),
        }
        rows.append({**row, "candidate": candidate})
    learned = [row["candidate"] for row in order(rows, read_campaigns(), "response 0.9")]
    return sorted(learned, key=lambda candidate: candidate.turn)


def settings_of(candidate: Candidate) -> dict[str, Any]:
    """Return what a person's own nodes need; `exports` are the lines for a shell."""
    path, cell = None if candidate.path is None else candidate.path.absolute(), candidate.cells[0]
    variables = {} if path is None else variables_of(candidate.vendor, path)
    exports = [] if path is None else [f"# first copy {path} to the same path on each device"]
    exports += [f"export {name}={shlex.quote(value)}" for name, value in variables.items()]
    if rmw := cell.rmw or next((rmw for rmw, of in ROS_MIDDLEWARES.items() if of.vendor == candidate.vendor), None):
        variables["RMW_IMPLEMENTATION"] = rmw
        is_native = cell.backend != "ros2"
        exports.append(f"export RMW_IMPLEMENTATION={rmw}{'  # ROS 2; its own API was measured' * is_native}")
        exports += ROUTERS * (rmw == "rmw_zenoh_cpp")
    return {
        **{key: getattr(candidate, key) for key in ("middleware", "vendor", "bundle")},
        "configuration": None if path is None else str(path),
        "variables": variables,
        "exports": exports,
    }


def fits_words(question: Question, fits: Mapping[str, float | None], cut_short: Collection[str], runs: int) -> str:
    """The time of axes in `cut_short` ran out."""
    rate, size = fits["rate_hz"], fits.get("size_bytes")
    requested = max(question.plan.cells, key=lambda cell: cell.payload_bit_s or 0.0)
    at_size = f"at {format_size(requested.size)}" if requested.size else "at this size"
    at_rate = f"at {format_rate(requested.rate)}"
    axes = {"rate_hz": f"rate {at_size}", "size_bytes": f"size {at_rate}"}
    unproven = [
        f"no {axes[name]} was proven ({'its time ran out' if name in cut_short else 'all broke limits'})"
        for name, value in fits.items()
        if not value
    ]
    parts = [f"{format_rate(rate)} {at_size}"] if rate else []
    parts += [f"{format_size(int(size))} {at_rate}"] if size else []
    if not parts:
        return "; ".join(unproven)
    others = " (the largest message, the others in proportion)" if len(question.messages) > 1 else ""
    fitting = f"{' or '.join(parts)}{others} kept the limits in {counted(runs, 'fresh run')}"
    return "; ".join([fitting, *unproven])
