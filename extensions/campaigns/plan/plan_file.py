"""Reads a plan's TOML file; errors name the key and the remedy."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.files import expand_home, read_settings
from dds_trace.base.printable import printable
from dds_trace.base.toml_table import TomlTable
from dds_trace.base.units import parse_size
from dds_trace.extensions.gates.sections import read_thresholds
from dds_trace.recorder.choices import Security
from dds_trace.recorder.domains import default_domain
from dds_trace.recorder.options import DEFAULT_MESSAGES
from dds_trace.recorder.payloads import check_data

from .cells import AXES, DEFAULTS, Cell, OutageBy
from .flows import FLOW_KEYS, MESSAGE_AXES, MOST_FLOWS, Flow, fan_out_faults, flow_cells, sender_cells
from .link import PRESETS, Link, read_drive
from .plan import DeviceSettings, Exclusion, Network, Order, Plan, RunSettings, Search, connects_to_relay
from .schema import INSTALLED, PLAN_LIMITS, TABLES, axis_choices

FindInstalled: TypeAlias = Callable[[], Collection[tuple[str, str | None]]]
AxisValue: TypeAlias = str | int | float | bool | None
AxisValues: TypeAlias = dict[str, list[AxisValue]]

MAX_RUNS = 200_000
"""Most runs of a sweep, nine days of four seconds each."""

MOST_NAME_BYTES = 200
"""Longest name of a cell: with `.r1000.relay.mcap.ring.0123abcd.part` a file's name has at most 255 bytes."""

_PASS_NAME = re.compile(r"(.+)_r([1-9][0-9]{0,6})")


def read_plan(path: Path, installed: FindInstalled = tuple, *, by_hand: bool = False) -> Plan:
    """Read a plan; `by_hand` if a person starts the relay. An `OptionError` names a file, key or value that is wrong."""
    text = read_settings(path, "a plan", "give the path of a plan such as plans/quick.toml")
    return parse_plan(text, path.stem, str(path), installed, by_hand=by_hand)


def parse_plan(text: str, name: str, where: str, installed: FindInstalled = tuple, *, by_hand: bool = False) -> Plan:
    root = TomlTable.parse(text, where, PLAN_LIMITS)
    root.allow(*TABLES[""].words)
    axes = [_axis_values(table) for table in root.tables("axes")] or [{}]
    matrices = [_axis_values(table) for table in root.tables("matrix")] or [{}]
    exclusions = [
        Exclusion(
            values={axis: tuple(values) for axis, values in _axis_values(rule, ignore=("reason",)).items()},
            reason=rule.take("reason", str, ""),
        )
        for rule in root.tables("exclude")
    ]
    run = root.table("run").fill(RunSettings(domain=default_domain()))
    if not {"messages", "seconds"} & set(root.table("run").values):
        run = replace(run, messages=DEFAULT_MESSAGES)
    check_runs(where, len(axes) * len(matrices), run.repeats)
    combined = [{**shared, **matrix} for shared in axes for matrix in matrices]
    check_runs(where, sum(_count_cells(values, installed) for values in combined), run.repeats)
    listed = [cell for values in combined for cell in _cells(values, installed)]
    flows = _flows(root, combined)
    if flows:
        listed = [cell for setup in listed for cell in flow_cells(setup, flows)]
        check_runs(where, len(listed), run.repeats)
        if "order" not in root.table("run").values:
            run = replace(run, order=Order.ALTERNATING)
    listed = [sender for setup in listed for sender in sender_cells(setup)]
    check_runs(where, len(listed), run.repeats)
    if not listed:
        raise OptionError(f"{where}: the plan has nothing to record; give [axes] or [[matrix]] some values")
    cells, excluded = _apply(exclusions, listed)
    _check_names(cells, where, run.repeats)
    link = _link(root.table("link"))
    is_list = isinstance(root.values.get("devices"), list)
    hosts = tuple(table.fill(DeviceSettings()) for table in root.tables("devices")) if is_list else ()
    devices = TomlTable({}, where) if is_list else root.table("devices")
    devices.allow(*TABLES["devices"].words)
    relay = hosts[0] if hosts else devices.table("relay").fill(DeviceSettings())
    network = root.table("network").fill(Network())
    name = root.take("name", str, name)
    limits.check(limits.FILE_NAME, name, f"{root.where}: the name of the file")
    plan = Plan(
        name=name,
        description=root.take("description", str, ""),
        cells=tuple(cells),
        excluded=tuple(excluded),
        run=run,
        ping=devices.table("ping").fill(DeviceSettings()),
        relay=relay,
        namespaces=network.namespaces or link is not None or any(cell.link for cell in cells),
        link=link,
        connectivity=devices.take("connectivity", str, _connectivity(link, network.namespaces, relay, by_hand)),
        by_hand=by_hand,
        search=root.table("search").fill(Search()),
        thresholds=tuple(read_thresholds(root.table("thresholds"))),
        flows=tuple(flow.name for flow in flows),
        hosts=hosts,
        text=text if "name" in root.values else f'name = "{name}"\n{text}',
    )
    _check(plan, where)
    return plan


def _flows(root: TomlTable, combined: Collection[AxisValues]) -> list[Flow]:
    flows = []
    for table in root.tables("flows"):
        table.allow(*FLOW_KEYS)
        name = table.take("name", str, "")
        message = {
            axis: _axis_value(table, axis, table.values[axis])
            for axis in FLOW_KEYS
            if axis in table.values and axis != "name"
        }
        flows.append(Flow(name, message))
    names = [flow.name for flow in flows]
    message_axes = sorted({axis for values in combined for axis in values} & set(MESSAGE_AXES))
    faults = (
        (len(flows) == 1 or len(flows) > MOST_FLOWS, f"there are 2 to {MOST_FLOWS} [[flows]], not {len(flows)}"),
        ("" in names, "each of [[flows]] needs a name, such as name = 'imu'"),
        (len(set(names)) < len(names), f"two of [[flows]] have one name ({', '.join(names)}); give each its own"),
        (
            bool(message_axes),
            f"{', '.join(message_axes)} are keys of each of [[flows]]; remove them from [axes] and [[matrix]]",
        ),
        (not root.table("run").take("seconds", float, 0.0), "[[flows]] need [run] seconds, which all flows last"),
    )
    for is_at_fault, sentence in faults if flows else ():
        if is_at_fault:
            raise OptionError(f"{root.where}: {sentence}")
    return flows


def _connectivity(link: Link | None, namespaces: bool, relay: DeviceSettings, by_hand: bool) -> str | None:
    if link is not None:
        return link.connectivity
    if relay.ssh is not None or by_hand:
        return None
    return "wired" if namespaces else "loopback"


def check_runs(where: str, cells: int, passes: int) -> None:
    if cells * passes > MAX_RUNS:
        times = f" in {passes:,} repeats" if passes > 1 else ""
        raise OptionError(
            f"{where}: {cells:,} results{times} are more than the {MAX_RUNS:,} runs of the largest sweep; give axes fewer "
            "values, or write a [[matrix]] for each part"
        )


def _count_cells(axes: AxisValues, installed: FindInstalled) -> int:
    counts = [len(values) for values in axes.values()]
    if axes.get("backend") == [INSTALLED]:
        counts = [len(values) for axis, values in axes.items() if axis not in ("backend", "rmw")]
        counts.append(len(installed()))
    return math.prod(counts)


def _cells(axes: AxisValues, installed: FindInstalled) -> Iterator[Cell]:
    """Yield every combination; the last axis changes fastest."""
    if axes.get("backend") == [INSTALLED]:
        others = {axis: values for axis, values in axes.items() if axis not in ("backend", "rmw")}
        for backend, rmw in installed():
            yield from _cells({"backend": [backend], "rmw": [rmw], **others}, installed)
        return
    for values in itertools.product(*axes.values()):
        yield replace(Cell(), **dict(zip(axes, values, strict=True)))  # type: ignore[arg-type]  # checked by `_axis_value`


def _apply(exclusions: list[Exclusion], listed: list[Cell]) -> tuple[list[Cell], list[tuple[Cell, str]]]:
    included: list[Cell] = []
    excluded: list[tuple[Cell, str]] = []
    for cell in listed:
        rule = next((rule for rule in exclusions if rule.covers(cell)), None)
        if rule is None:
            included.append(cell)
        else:
            excluded.append((cell, rule.reason))
    return included, excluded


def _check_names(cells: list[Cell], where: str, passes: int) -> None:
    seen: set[str] = set()
    for cell in cells:
        if cell.name in seen:
            raise OptionError(f"{where}: {cell.name} is there twice; two [[matrix]] overlap, so remove it from one")
        if len(cell.name.encode()) > MOST_NAME_BYTES:
            raise OptionError(
                f"{where}: {cell.name[:60]}... has a name of {len(cell.name.encode())} bytes, which no file may have; "
                "give its data or environment a shorter path"
            )
        seen.add(cell.name)
    for name in seen:
        match = _PASS_NAME.fullmatch(name)
        if match is not None and match[1] in seen and 1 < int(match[2]) <= passes:
            raise OptionError(
                f"{where}: {name} would be repeat {match[2]} of {match[1]}; rename the folder of its environment"
            )


def _check(plan: Plan, where: str) -> None:
    run, search = plan.run, plan.search
    faults = (
        (
            (run.messages > 0) == (run.seconds > 0),
            "[run] needs either messages or seconds above zero; give one of them, or none for the default",
        ),
        (
            any(math.isinf(cell.rate) and (cell.outage or not run.seconds) for cell in plan.cells),
            'rate = "max" needs [run] seconds, and no outage',
        ),
        (
            any(cell.ping_share is not None and math.isfinite(cell.rate) for cell in plan.cells),
            'ping_share needs rate = "max"; on a schedule every message is sent back',
        ),
        (
            any(
                math.isfinite(cell.rate) and run.messages_at(cell.rate, cell.outage) > limits.MAX_MESSAGES
                for cell in plan.cells
            ),
            f"a run has more than {limits.MAX_MESSAGES} messages; give fewer seconds or a lower rate",
        ),
        (
            any(run.planned_seconds(cell.rate, cell.outage) > limits.YEAR_S for cell in plan.cells),
            "a run takes more than a year; give fewer messages or a higher rate",
        ),
        (
            any(cell.crosses_domains for cell in plan.cells) and run.domain == run.ping_domain,
            f"[run] domain and ping_domain are both {run.domain}, but a bridge joins two domains; give different ones",
        ),
        (
            plan.has_two_devices and plan.namespaces,
            "[link] and [network] need both devices on this machine; remove them or the other device",
        ),
        (
            plan.has_two_devices
            and not plan.relay.reached_at
            and any(connects_to_relay(cell.backend) or plan.runs_halves(cell) for cell in plan.cells),
            "the ping does not know where the relay is; give [devices.relay] an address",
        ),
        (
            plan.has_two_devices and any(cell.environment for cell in plan.cells),
            "the axis environment needs both devices on this machine; remove it or the other device",
        ),
        (
            plan.by_hand and any(cell.configuration for cell in plan.cells),
            "the axis configuration needs a device that ssh reaches; set the middleware's own variable on each, or use `dds-trace record ROLE --configuration`",
        ),
        (
            plan.has_two_devices and any(cell.security != Security.OFF.value for cell in plan.cells),
            "the axis security needs both devices on this machine, as no key is sent; use `dds-trace record ROLE -o security` and `-o keys`",
        ),
        (
            any(cell.outage and cell.outage_by != OutageBy.RELAY.value for cell in plan.cells) and not plan.namespaces,
            "the axis outage needs the two sides in namespaces; give [network] namespaces = true, a [link], or outage_by = 'relay'",
        ),
        (
            any(cell.queue for cell in plan.cells)
            and not (plan.link and plan.link.rate_mbit_s and (plan.link.needs_only_rate or not plan.link.shared)),
            "the axis queue needs a [link] with a rate, without delay and loss if it is shared; change it or remove the axis",
        ),
        (
            any(cell.link for cell in plan.cells)
            and (plan.link is not None or any(cell.hosts > 1 for cell in plan.cells)),
            "the axis link is in place of a [link], and joins two hosts; remove [link] and hosts, or the axis",
        ),
        (
            any(cell.outage for cell in plan.cells) and (plan.has_two_devices or bool(plan.flows)),
            "the axis outage needs both devices on this machine, and no [[flows]]; remove them or the axis",
        ),
        (
            bool(plan.flows) and any(cell.crosses_domains for cell in plan.cells),
            "[[flows]] are measured in one domain; remove the bridge, which each of their pings would start",
        ),
        (
            plan.ping.ssh is not None,
            "[devices.ping] has ssh, but the ping always runs on this machine; give ssh to [devices.relay]",
        ),
        (
            search.min_rate >= search.max_rate,
            f"[search] min_rate ({search.min_rate:g}) must be below max_rate ({search.max_rate:g})",
        ),
        *fan_out_faults(plan),
    )
    for is_at_fault, sentence in faults:
        if is_at_fault:
            raise OptionError(f"{where}: {sentence}")


def read_link(text: str) -> Link:
    """Return the link of a preset's name, or of a file with a table `[link]`."""
    if text in PRESETS:
        return PRESETS[text]
    link = _link(
        _read_table(text, "a link", f"give a TOML file with [link], or one of {', '.join(PRESETS)}").table("link")
    )
    if link is None:
        raise OptionError(f"{text}: there is no [link]; write one, as in plans/lossy-link.toml")
    return link


def read_host(text: str) -> DeviceSettings:
    """Return the device of an ssh name, or of a file with a table `[devices.relay]`."""
    if not text.endswith(".toml"):
        limits.check(limits.HOST, text.rpartition("@")[2], "--host")
        return DeviceSettings(ssh=text)
    host = _read_table(text, "a device", "give a TOML file with [devices.relay], or the name of the device for ssh")
    device = host.table("devices").table("relay").fill(DeviceSettings())
    if device.ssh is None:
        raise OptionError(f"{text}: [devices.relay] has no ssh; write ssh = 'user@host'")
    return device


def _read_table(path: str, what: str, remedy: str) -> TomlTable:
    return TomlTable.parse(read_settings(Path(path), what, remedy), path, PLAN_LIMITS)


def _link(table: TomlTable) -> Link | None:
    if not table.values:
        return None
    preset = table.take("preset", str, None)
    base = PRESETS[preset] if preset else Link()
    link = table.fill(base, "preset")
    if preset and table.values.keys() - {"preset"} and "name" not in table.values:
        link = replace(link, name=f"{base.name}-changed")
    if (link.outage_ms > 0) != (link.outage_every_s > 0):
        raise OptionError(f"{table.where}: an outage has both outage_every_s and outage_ms; give both or none")
    if link.shared and not link.rate_mbit_s:
        raise OptionError(f"{table.where}: what both directions share is a rate; give rate_mbit_s, or remove shared")
    if link.file:
        ours = table.values.keys() - {"file", "name", "queue_ms"}
        if ours:
            raise OptionError(f"{table.where}: file has rate, delay, jitter and loss; remove {', '.join(sorted(ours))}")
        path = Path(table.path).parent / expand_home(link.file)
        link = replace(link, file=str(path), name=link.name if "name" in table.values else path.stem)
        limits.check(limits.FILE_NAME, link.name, f"{table.where}: the name of the file")
        try:
            read_drive(link.file)
        except OptionError as err:
            raise OptionError(f"{table.where}: {printable(err, 1000)}") from err  # a path may have line breaks
    return link


def _axis_values(table: TomlTable, ignore: Collection[str] = ()) -> AxisValues:
    table.allow(*AXES, *ignore)
    return {
        axis: [_axis_value(table, axis, value) for value in (listed if isinstance(listed, list) else [listed])]
        for axis, listed in table.values.items()
        if axis not in ignore
    }


def _axis_value(table: TomlTable, name: str, value: object) -> AxisValue:
    axis, default = AXES[name], DEFAULTS[name]
    if value == "" and default is None:
        return None
    try:
        if isinstance(value, str) and axis.unit == "bytes":
            value = parse_size(value)
        elif name == "rate" and value == "max":
            return math.inf
        elif name == "data" and isinstance(value, str):
            check_data(value)
    except OptionError as err:
        raise OptionError(f"{table.where}: {err}") from err
    if choices := axis_choices(name):
        return table.choose(name, value, choices)
    if name == "rate" and value == math.inf:  # JSON has no infinity, so a schema cannot take it
        raise OptionError(f"{table.where}: rate is inf; write 'max'")
    return table.check(name, value, axis.kind)
