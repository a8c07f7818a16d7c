"""The options of one recording, and the refusal of wrong ones before anything is opened."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError, OutputExistsError, TraceDestination

from .choices import Serialization

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .backends.node import NodeOptions

MAX_RELAY_ID = (1 << 32) - 1
MAX_RATE_HZ = 1e6
DEFAULT_MESSAGES = 1000
"""Messages of a run by default: what gates were simulated with (docs/coverage.md). With five runs a side that spread by
5 % they find +20 % of p50 four times in five; p99 rests on ten messages of a run."""
DEFAULT_RATE_HZ = 10.0
DEFAULT_WARMUP = 10


@dataclass(frozen=True, slots=True)
class PingOptions:
    """The options of a ping.

    Attributes:
        data: name of a data type, or a source such as `file:PATH` (see `payloads.PAYLOADS`).
        size_bytes: application bytes of a message, None for the type's default.
        rate_hz: messages a second; None for the rate of the data, or 10 if it has none.
        messages: messages that count, warm-up not included; None for what fits the duration, or 1000.
        warmup: messages sent before them.
        wait_s: longest wait for an echo, in seconds.
        relays: number of relays that must send one; those in sight are waited for in any case.
        seed: seed of the payload's random content, drawn if None.
        bridge: `none`, or the bridge to the relay's domain, started and ended with the recording.
        bridge_running: whether the bridge runs already, so that nothing is started.
        bridge_listen: `HOST:PORT` at which the ping's half of the bridge waits for the relay's.
        bridge_peers: `HOST:PORT` of each other half that the ping's half connects to.
        relay_domain_id: domain of the relay, the ping's own if None.
        labels: texts of the user's, kept with the run.
        settings: what the surroundings were set to (an emulated link, a load), told with the run's own settings.
    """

    data: str = "binary"
    size_bytes: int | None = None
    rate_hz: float | None = None
    messages: int | None = None
    warmup: int = DEFAULT_WARMUP
    wait_s: float = 20.0
    relays: int = 1
    seed: int | None = None
    bridge: str = "none"
    bridge_running: bool = False
    bridge_listen: str | None = None
    bridge_peers: tuple[str, ...] = ()
    relay_domain_id: int | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)

    def check(self) -> None:
        """Refuse values that make no sense.

        Raises:
            OptionError: naming the option.
        """
        if self.rate_hz is not None and not 0 < self.rate_hz <= MAX_RATE_HZ:
            raise OptionError(
                f"--rate {self.rate_hz:g}: give more than 0 and at most {MAX_RATE_HZ:.0f} a second"
            )
        if self.messages is not None and self.messages < 1:
            raise OptionError(f"--messages {self.messages}: give at least one message to measure")
        if self.warmup < 0:
            raise OptionError(f"--warmup {self.warmup}: give 0 or more")
        if self.relays < 1:
            raise OptionError(f"--relays {self.relays}: give at least one relay to wait for")
        joins_halves = self.bridge_listen is not None or bool(self.bridge_peers)
        if self.bridge == "none" and (self.bridge_running or joins_halves):
            raise OptionError("--bridge-running, --bridge-listen and --bridge-peer need --bridge NAME")
        if self.bridge_running and joins_halves:
            raise OptionError("--bridge-running starts nothing: leave --bridge-listen and --bridge-peer out")


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """The options of one recording: a ping's with `ping`, a relay's without.

    Attributes:
        destination: place of the trace.
        node: options of the node; its `name` and `listens` are set by the role.
        ping: options of the ping, None for a relay.
        backend: name of the backend.
        serialization: form in which the messages pass the client library.
        relay_id: number of a relay, drawn if None.
        types: message types that a relay serves beside those of data that is made up.
        device: name of the device, by default its host name.
        connectivity: the device's link to the others, by default looked up (`session.default_connectivity`).
        duration_s: length of the recording in seconds; a relay without it goes on until stopped.
        cpu_affinity: CPUs to run on, as `privileges.parse_cpus` reads them.
        realtime_priority: 1 to 99 for SCHED_FIFO with locked memory.
        strict: whether a setting that the middleware does not use ends the recording.
        wire: whether the packets of the run's interfaces are counted.
    """

    destination: TraceDestination
    node: NodeOptions
    ping: PingOptions | None = None
    backend: str = "ros2"
    serialization: Serialization = Serialization.RAW
    relay_id: int | None = None
    types: tuple[str, ...] = ()
    device: str | None = None
    connectivity: str | None = None
    duration_s: float | None = None
    cpu_affinity: str | None = None
    realtime_priority: int | None = None
    strict: bool = False
    wire: bool = False

    def check(self) -> None:
        """Refuse values that make no sense, and an output that is there already.

        Raises:
            OptionError: naming the option.
            OutputExistsError: there is a trace already; known now, and not after the wait for an echo.
        """
        destination = self.destination
        if destination.path.exists() and not destination.force:
            raise OutputExistsError(
                f"{destination.path} is there already; choose another name or use --force"
            )
        if self.relay_id is not None and not 1 <= self.relay_id <= MAX_RELAY_ID:
            raise OptionError(f"--relay-id {self.relay_id}: a relay's id is 1 to {MAX_RELAY_ID}")
        if self.duration_s is not None and self.duration_s <= 0:
            raise OptionError(f"--duration {self.duration_s:g}: give more than 0 seconds")
        if self.node.qos.depth < 1:
            raise OptionError(f"--depth {self.node.qos.depth}: at least one message must be kept")
        if self.ping is not None:
            self.ping.check()
