"""`dds-trace doctor`: what can be measured on this machine, what cannot, why, and what to install."""

from __future__ import annotations

import json
import os
import textwrap
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dds_trace.base import limits
from dds_trace.base.errors import TraceError
from dds_trace.base.extension import offers
from dds_trace.base.units import format_duration, format_size
from dds_trace.recorder.backends import load_backends
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery

from .program import command, make_app, option

if TYPE_CHECKING:
    from dds_trace.recorder.backends.base import Backend

app = make_app()


_PARTS = ("middlewares", "bridges", "security", "buffers", "clocks", "permissions")


@dataclass(frozen=True, slots=True)
class Check:
    part: str
    name: str
    works: bool
    detail: str


@command(app, "doctor")
def doctor_command(
    out: Annotated[Path | None, option("--out PATH", "Measure what recording costs on the disk of this path.")] = None,
    as_json: Annotated[bool, option("--json", "Print the checks as JSON.")] = False,
) -> None:
    """Check this machine: middlewares, missing packages, limits.

    Middlewares, bridges, security, buffers, clocks, permissions, and what recording itself costs here (some seconds).
    """
    limits.check(limits.PATH, None if out is None else str(out), "--out")
    checks = all_checks(out)
    if as_json:
        print(json.dumps([asdict(check) for check in checks], indent=2))
        return
    for part in dict.fromkeys(check.part for check in checks):
        print(f"{part}:")
        for check in checks:
            if check.part == part:
                line = f"{'+' if check.works else '-'} {check.name}: {check.detail}"
                print(textwrap.fill(line, 80, initial_indent="  ", subsequent_indent="      ", break_on_hyphens=False))


def all_checks(out: Path | None) -> list[Check]:
    checks = [*middleware_checks(), *_security(), *_machine(), *_permissions()]
    checks += [Check(*row) for find in offers("checks").values() for row in find()()]
    return [*sorted(checks, key=lambda check: _PARTS.index(check.part)), *_costs(out)]


def _installed() -> list[Backend]:
    return [backend for backend in load_backends() if backend.find_installed()]


def middleware_checks() -> Iterator[Check]:
    for backend in load_backends():
        installed = backend.find_installed()
        describe = backend.describe_installed or (lambda: "installed")
        detail = describe() if installed else backend.install
        yield Check("middlewares", f"--backend {backend.name}", bool(installed), detail)


def _security() -> Iterator[Check]:
    import tempfile

    from dds_trace.recorder.domains import default_domain
    from dds_trace.recorder.security.keys import opened_keys

    for backend in _installed():
        for level in backend.security[-1:]:
            asked, environment = f"-o security={level.value}", dict(os.environ)
            name = f"--backend {backend.name} {asked}"
            try:
                with tempfile.TemporaryDirectory() as folder, opened_keys(level, f"{folder}/keys") as keys:
                    options = NodeOptions(
                        default_domain(), discovery=Discovery.LOCALHOST, security=level, keys=keys, listens=True
                    )
                    backend.open_node(options).close()
                yield Check("security", name, True, "a node opens with it")
            except TraceError as err:
                yield Check("security", name, False, str(err).removeprefix(f"{asked}: "))
            finally:
                os.environ.clear()
                os.environ |= environment  # without what a node of ROS 2 sets for its keys


def _machine() -> Iterator[Check]:
    from dds_trace.recorder.host.fingerprint import read_text
    from dds_trace.recorder.kernel.counters import read_limits

    largest_bytes, enough = read_limits().get("net.core.rmem_max"), 4_194_304
    shown = "not shown in this container; on its host" if largest_bytes is None else format_size(largest_bytes)
    is_enough = largest_bytes is not None and largest_bytes >= enough
    cure = "" if is_enough else f": sudo sysctl net.core.rmem_max={enough}, or large messages get lost"
    yield Check("buffers", "net.core.rmem_max", is_enough, f"{shown}{cure}")
    source = read_text("/sys/devices/system/clocksource/clocksource0/current_clocksource") or "unknown"
    yield Check("clocks", "clock source", source in ("tsc", "arch_sys_counter", "kvm-clock"), source)


def _permissions() -> Iterator[Check]:
    from dds_trace.recorder.host.process import HOW_TO_BE_PERMITTED, may_be_realtime

    is_permitted = may_be_realtime()
    yield Check("permissions", "-o realtime", is_permitted, "permitted" if is_permitted else HOW_TO_BE_PERMITTED)


def _costs(out: Path | None) -> Iterator[Check]:
    from dds_trace.recorder.roles.floor import measure_recorder_cost

    # The nearest existing folder is on the same disk.
    folder = None if out is None else next(folder for folder in out.absolute().parents if folder.is_dir())
    cost = measure_recorder_cost(folder)
    # At 1 kHz caches are cold, as in a node.
    cold = f", {_us(cost.cold_timer_ns)} at 1 kHz, subtracted" if cost.cold_timer_ns else ""
    yield Check(
        "cost",
        "recording an event",
        True,
        f"median {_us(cost.record_median_ns)}, p99 {_us(cost.record_p99_ns)}, slowest {_us(cost.record_max_ns)} ({cost.events} "
        f"events at 1 kHz); slowest ten in a row: {_us(cost.stall_of_ten_ns)}; reading the clock: {_us(cost.timer_ns)}{cold}",
    )
    yield from map(_floor, _installed())


def _floor(backend: Backend) -> Check:
    from dds_trace.recorder.domains import default_domain
    from dds_trace.recorder.roles.floor import measure_floor

    name = f"floor of {backend.name}"
    try:
        floor = measure_floor(backend.name, NodeOptions(default_domain(), discovery=Discovery.LOCALHOST))
    except TraceError as err:
        return Check("cost", name, False, f"not measured, {err}")
    times = f"median {_us(floor.median_ns)}, p99 {_us(floor.p99_ns)}"
    return Check("cost", name, True, f"{times} (a node to itself, {floor.messages} messages)")


def _us(duration_ns: float) -> str:
    return format_duration(duration_ns, "µs")
