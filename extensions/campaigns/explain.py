"""Plans that explain a rise of the latency at slow rates or around a size, with one thing varied at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.units import parse_size
from dds_trace.recorder.applied.vendors import ros_middleware
from dds_trace.recorder.backends import BACKEND_MODULES, load_backend
from dds_trace.recorder.choices import Load, Transport
from dds_trace.recorder.kernel.counters import read_limits

from .load import DMA_LATENCY
from .plan.cells import DEFAULTS, Cell
from .plan.plan import Order, Plan

LEAST_REPEATS, USUAL_REPEATS = 3, 5
WAKE_MS = 5
CONDITIONS: Mapping[str, dict[str, Any]] = {
    "awake": {"load": Load.AWAKE.value},
    "dma_latency": {"load": Load.DMA_LATENCY.value},
    "realtime": {"realtime": 50},
    "wake": {"wake": WAKE_MS},
}
AROUND = (0.75, 1.25)
LARGE_FRAGMENT_BYTES, SMALL_FRAGMENT_BYTES = 60_000, 1_400
CYCLONE_FRAGMENT_BYTES = 1_344
IDLE_DRIVER = Path("/sys/devices/system/cpu/cpuidle/current_driver")
AS_IS, MACHINE, NATIVE = "as is", "machine", "native"
"""Keys besides what is varied: the setup itself, plain sockets, and the vendor without the client library."""


@dataclass(frozen=True, slots=True)
class ExplainedSetup:
    name: str
    pairs: Mapping[str, tuple[Cell, Cell]]


@dataclass(frozen=True, slots=True)
class Explanation:
    """A sweep that explains; `left_out` is what cannot be varied, with the reason."""

    plan: Plan
    setups: tuple[ExplainedSetup, ...]
    left_out: Mapping[str, str] = field(default_factory=dict)
    is_of_rates: bool = True


def explain_rates(plan: Plan) -> Explanation:
    """Return the sweep of each setup of a plan at its fastest and slowest rate, as it is and under `CONDITIONS`."""
    condition_axes = sorted({axis for axes in CONDITIONS.values() for axis in axes})
    if any(getattr(cell, axis) != DEFAULTS[axis] for cell in plan.cells for axis in condition_axes):
        raise OptionError(f"explain rates varies {', '.join(condition_axes)}; remove them from the plan")
    rates = {cell.rate for cell in plan.cells}
    slow_hz, fast_hz = min(rates), max(rates)
    if slow_hz == fast_hz or math.isinf(fast_hz):
        raise OptionError(
            f"explain rates: the plan has no two rates ({fast_hz:g} Hz); give it two, such as rate = [10, 500]"
        )
    left_out = _refused_conditions(slow_hz)
    setups = []
    for fast in dict.fromkeys(replace(cell, rate=fast_hz) for cell in plan.cells):
        plain = Cell(backend="socket", data=fast.data, size=fast.size, rate=fast_hz)
        cells = {AS_IS: fast, MACHINE: plain, NATIVE: _native(fast)}
        pairs = {key: (cell, replace(cell, rate=slow_hz)) for key, cell in cells.items() if cell is not None}
        for name, axes in CONDITIONS.items():
            if name not in left_out:  # at the fast rate the message before is the probe
                pairs[name] = fast if name == "wake" else replace(fast, **axes), replace(fast, rate=slow_hz, **axes)
        if fast.backend == "socket":
            del pairs[MACHINE]
        setups.append(ExplainedSetup(_name(fast), pairs))
    return _explanation(plan, setups, left_out, is_of_rates=True)


def _refused_conditions(slow_hz: float) -> dict[str, str]:
    reasons = {}
    if not Path(DMA_LATENCY).exists():
        reasons["dma_latency"] = f"there is no {DMA_LATENCY} here"
    elif not IDLE_DRIVER.exists() or IDLE_DRIVER.read_text().strip() == "none":
        reasons["dma_latency"] = "this kernel has no driver of idle states (cpuidle)"
    if slow_hz * WAKE_MS >= 1000:
        reasons["wake"] = f"at {slow_hz:g} Hz the message before is the probe"
    return reasons


def _native(cell: Cell) -> Cell | None:
    vendor = ros_middleware(cell.rmw).vendor if cell.backend == "ros2" and cell.rmw else ""
    if vendor not in BACKEND_MODULES or cell.crosses_domains or not load_backend(vendor).find_installed():
        return None
    client: dict[str, Any] = {name: DEFAULTS[name] for name in ("rmw", "executor", "serialization")}
    return replace(cell, backend=vendor, **client)


def explain_size(plan: Plan, text: str) -> Explanation:
    """Return the sweep of each setup of a plan around a size (`SIZE`, or `LOW..HIGH`), each factor varied by itself."""
    sizes = [parse_size(part, "SIZE") for part in text.split("..", 1)]
    low, high = sizes if len(sizes) > 1 else (round(share * sizes[0]) for share in AROUND)
    limits.check(limits.SIZE_BYTES, high, "SIZE")
    if low >= high:
        raise OptionError(f"SIZE {limits.shown(text)}: the first size must be below the second")
    sized = [cell for cell in plan.cells if cell.data in ("binary", "string")]
    if not sized:
        raise OptionError("explain size: the plan has no data with a size to choose; give it binary or string")
    fixed = {cell.data for cell in plan.cells} - {cell.data for cell in sized}
    left_out = dict.fromkeys(sorted(fixed), "it has no size to choose")
    setups = []
    for small in dict.fromkeys(replace(cell, size=low) for cell in sized):
        name = f"{_name(small)} {small.rate:g} Hz"
        pairs = {AS_IS: (small, replace(small, size=high))}
        for factor, axes in _factors(plan, small, high).items():
            if axes:
                pairs[factor] = replace(small, **axes), replace(small, size=high, **axes)
            else:
                is_queue = factor == "queue"
                left_out[factor] = "the plan has no [link] with a rate" if is_queue else f"{name} has none to choose"
        setups.append(ExplainedSetup(name, pairs))
    return _explanation(plan, setups, left_out, is_of_rates=False)


def _factors(plan: Plan, cell: Cell, large_bytes: int) -> dict[str, dict[str, Any]]:
    backend = load_backend(cell.backend)
    is_sized = not cell.rmw or ros_middleware(cell.rmw).vendor == "fastdds"
    names = backend.sizes.get(Transport(cell.transport), ()) if is_sized else ()
    usual_bytes = CYCLONE_FRAGMENT_BYTES if cell.backend == "cyclonedds" else LARGE_FRAGMENT_BYTES
    is_small = (cell.fragment or usual_bytes) < LARGE_FRAGMENT_BYTES / 2
    sizes = {
        "buffer": min(read_limits().get("net.core.rmem_max", 1 << 22), max(1 << 22, 4 * large_bytes)),
        "segment": max(1 << 25, 8 * large_bytes),
        "fragment": LARGE_FRAGMENT_BYTES if is_small else SMALL_FRAGMENT_BYTES,
    }
    factors: dict[str, dict[str, Any]] = {name: {name: size} if name in names else {} for name, size in sizes.items()}
    history = {"history": DEFAULTS["history"]}
    is_short = cell.depth == 1 and cell.history == history["history"]
    factors["history"] = {**history, "depth": 100 if is_short else 1} if backend.speaks_dds else {}
    has_line = plan.link is not None and plan.link.rate_mbit_s
    factors["queue"] = {"queue": round(max(200, 10 * plan.link.queue_ms))} if has_line and plan.link else {}
    return factors


def _explanation(
    plan: Plan, setups: list[ExplainedSetup], left_out: Mapping[str, str], *, is_of_rates: bool
) -> Explanation:
    if plan.flows or any(cell.outage for cell in plan.cells):
        raise OptionError("[[flows]] and outages are swept as they are; remove them to explain a rise")
    repeats = plan.run.repeats if plan.run.repeats >= LEAST_REPEATS else USUAL_REPEATS
    run = replace(plan.run, repeats=repeats, order=Order.ALTERNATING, own_cost_passes=1)
    cells = dict.fromkeys(cell for setup in setups for pair in setup.pairs.values() for cell in pair)
    name = f"{plan.name}-{'rates' if is_of_rates else 'size'}"
    measured_plan = replace(plan, name=name, cells=tuple(cells), excluded=(), run=run, thresholds=())
    return Explanation(measured_plan, tuple(setups), left_out, is_of_rates)


def _name(cell: Cell) -> str:
    return " ".join([cell.middleware, *([cell.bridge] if cell.crosses_domains else []), *cell.changed_axes])
