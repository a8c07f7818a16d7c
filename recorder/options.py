"""The options of one recording, and the refusal of wrong ones before anything is opened."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING

from dds_trace.base import limits
from dds_trace.base.errors import OptionError, OutputExistsError

from .choices import Serialization
from .payloads import check_data

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.base.limits import Limit
    from dds_trace.tracefile.writing.destination import TraceDestination

    from .backends.node import NodeOptions

DEFAULT_MESSAGES = 1000
"""Messages of a run by default: what gates were simulated with (docs/explanation/coverage.md). With five runs a side that spread by
5 % they find +20 % of p50 four times in five; p99 rests on ten messages of a run."""
DEFAULT_RATE_HZ = 10.0
DEFAULT_WARMUP = 10
DEFAULT_WAIT_S = 20.0


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
    wait_s: float = DEFAULT_WAIT_S
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
        check_fields(self)
        check_data(self.data)
        for option, pairs in (("--label", self.labels), ("--setting", self.settings)):
            for key, value in pairs.items():
                limits.check(limits.LABEL_KEY, key, option)
                limits.check(limits.TEXT, value, f"{option} {key}")
        joins_halves = self.bridge_listen is not None or bool(self.bridge_peers)
        if self.bridge == "none" and (self.bridge_running or joins_halves):
            raise OptionError("--bridge-running, --bridge-listen and --bridge-peer need --bridge NAME")
        if self.bridge_running and joins_halves:
            raise OptionError("--bridge-running starts nothing: leave --bridge-listen and --bridge-peer out")


@dataclass(frozen=True, slots=True)
class Rotation:
    """When a relay goes on in a new file, whichever comes first, and how many files it keeps.

    Attributes:
        file_bytes: length of a file, None for any.
        age_s: time from its first event to the next file in seconds, None for any.
        keep: number of files of the recording that stay, the one that is written included; None for all.
    """

    file_bytes: int | None = None
    age_s: float | None = None
    keep: int | None = None


@dataclass(frozen=True, slots=True)
class KeepFree:
    """The free space that a recording leaves on its disk: a share of the disk or a number of bytes, whichever is less.

    Attributes:
        share: 0 to 1.
        most_bytes: bytes; None for the share alone.
    """

    share: float = 0.05
    most_bytes: int | None = 1_000_000_000

    def floor_bytes(self, disk_bytes: int) -> int:
        """Return the bytes to keep on a disk of this size."""
        share_bytes = int(self.share * disk_bytes)
        return share_bytes if self.most_bytes is None else min(share_bytes, self.most_bytes)


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
        own_cost: whether the session measures what recording and the client library cost, before its node opens.
        rotation: when a relay goes on in a new file; None for never.
        keep_free: free space to leave on the disk.
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
    own_cost: bool = True
    rotation: Rotation | None = None
    keep_free: KeepFree = KeepFree()

    def check(self) -> None:
        """Refuse values that make no sense, and an output that is there already.

        Raises:
            OptionError: naming the option.
            OutputExistsError: there is a trace already; known now, and not after the wait for an echo.
        """
        destination = self.destination
        check_fields(self)
        limits.check(limits.PATH, str(destination.path), "--out")
        if self.rotation is not None:
            _check_rotation(destination)
        elif destination.path.exists() and not destination.force:
            raise OutputExistsError(
                f"{destination.path} is there already; choose another name or use --force"
            )
        if self.ping is not None:
            self.ping.check()


def _check_rotation(destination: TraceDestination) -> None:
    if destination.is_bag:
        raise OptionError(
            "--rotate writes .mcap files: give --out NAME.mcap, which become NAME.00001.mcap and so on"
        )
    if destination.force:
        raise OptionError(
            "--rotate overwrites nothing: leave --force out; numbers go on behind those that are taken"
        )


OPTION_LIMITS: Mapping[str, tuple[str, Limit]] = {
    "size_bytes": ("--size", limits.SIZE_BYTES),
    "rate_hz": ("--rate", limits.RATE_HZ),
    "messages": ("--messages", limits.MESSAGES),
    "warmup": ("--warmup", limits.WARMUP),
    "wait_s": ("--wait", limits.WAIT_S),
    "relays": ("--relays", limits.RELAYS),
    "seed": ("--seed", limits.SEED),
    "bridge": ("--bridge", limits.NAME),
    "bridge_listen": ("--bridge-listen", limits.ADDRESS),
    "bridge_peers": ("--bridge-peer", limits.ADDRESS),
    "relay_domain_id": ("--relay-domain", limits.DOMAIN_ID),
    "domain_id": ("--domain", limits.DOMAIN_ID),
    "rmw": ("--rmw", limits.RMW),
    "peers": ("--peer", limits.HOST),
    "depth": ("--depth", limits.DEPTH),
    "backend": ("--backend", limits.NAME),
    "relay_id": ("--relay-id", limits.RELAY_ID),
    "types": ("--type", limits.NAME),
    "device": ("--device", limits.NAME),
    "connectivity": ("--connectivity", limits.NAME),
    "duration_s": ("--duration", limits.LENGTH_S),
    "cpu_affinity": ("--cpu-affinity", limits.CPUS),
    "realtime_priority": ("--realtime", limits.REALTIME_PRIORITY),
    "file_bytes": ("--rotate", limits.FILE_BYTES),
    "age_s": ("--rotate", limits.FILE_AGE_S),
    "keep": ("--keep", limits.RETAINED_FILES),
}
"""Field of a record of options -> its option and its validator. Fields that are no option, whose value is an Enum or a flag,
or that are checked where they are parsed (`data`, `labels`, the durations of a `Qos`) are not here."""


def check_fields(options: object) -> None:
    """Check every field of a record of options, and of the records in it, that `OPTION_LIMITS` names.

    Raises:
        OptionError: naming the option.
    """
    assert is_dataclass(options)
    for each in fields(options):
        value = getattr(options, each.name)
        if each.name in OPTION_LIMITS:
            option, limit = OPTION_LIMITS[each.name]
            for one in value if isinstance(value, tuple) else (value,):
                limits.check(limit, one, option)
        elif each.name in _RECORDS and value is not None:
            check_fields(value)


_RECORDS = ("node", "qos", "rotation")
"""Fields that hold records of options themselves; that of a ping checks its own."""
