"""`Backend`: the record of a middleware, one in each file of `recorder/backends/`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from importlib.util import find_spec
from pathlib import Path

from dds_trace.base import limits
from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.files import read_regular

from ..choices import Call, Discovery, ExecutorKind, Security, Transport, WhenFull
from ..domains import check_domain_id, domain_port_range, first_port
from ..host.environment import MiddlewareEnvironment, watched_configuration
from ..security.keys import LAST_SECURED_DOMAIN
from .node import Node, NodeOptions


class Meeting(Enum):
    """How the nodes of a ping and a relay meet."""

    DISCOVERY = "discovery"
    DISCOVERY_OR_PEERS = "discovery or peers"
    PEERS = "peers"
    """The ping connects to the relay's address, the relay listens."""


def dds_meeting(without_multicast: str) -> str:
    """Return what nodes need to meet; the likeliest first."""
    return (
        "both have the same --domain and --discovery and a --backend that speaks DDS ({dds_backends}), the network lets multicast "
        f"through ({without_multicast}), and a firewall UDP ports {{ports}}"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Backend:
    """One API that carries messages: `BACKEND` of each module in `BACKEND_MODULES`.

    Attributes:
        make_node: opens a node, not started; an `ImportError` means that the package is missing or broken.
        find_installed: returns the ROS middlewares here, `[None]` for a backend without, empty if it cannot run.
        describe_installed: returns their versions in words.
        install: how to install the middleware, for the end of a message.
        meeting_needs: what ping and relay need to meet, with `{port}` of the relay, `{ports}` of the domain and `{dds_backends}`.
        speaks_dds: whether its nodes meet nodes of other backends that speak DDS.
        relay_port: the relay's port among the 250 of the domain: 2 to 9, which DDS does not use.
        make_pair: opens a node that subscribes and one that publishes, where nodes do not receive their own messages.
        has_ros: whether the ROS middleware and the executor can be chosen.
        security: levels besides `off`.
        sizes: transport -> names of `Sizes` that can be chosen with it.
        can_drop: whether a publisher can block or drop, as requested, when the link is full.
        can_multicast: whether it sends messages to groups unless requested otherwise.
        variables_of: returns the variables that give a ROS middleware (None: the environment's) or the backend a file of settings.
        own_causes: yields for a node, a ROS middleware and variables what keeps this process from meeting others.
        profile_of: returns for a ROS middleware and environment variables the path of the profile in effect, and in words what is not read.
        check_settings: raises an `OptionError` for further options that have no effect.
        missing_rmw: returns how to install a ROS middleware, None for an installed one.
    """

    name: str
    label: str
    make_node: Callable[[NodeOptions], Node]
    find_installed: Callable[[], Sequence[str | None]]
    install: str
    meeting: Meeting
    meeting_needs: str
    speaks_dds: bool = False
    relay_port: int | None = None
    make_pair: Callable[[NodeOptions], tuple[Node, Node]] | None = None
    has_ros: bool = False
    has_congestion_control: bool = False
    transports: tuple[Transport, ...] = (Transport.DEFAULT,)
    security: tuple[Security, ...] = ()
    priorities: range | None = None
    sizes: Mapping[Transport, tuple[str, ...]] = field(default_factory=dict)
    can_drop: bool = False
    can_multicast: bool = False
    calls: tuple[Call, ...] = ()
    environment: MiddlewareEnvironment = field(default_factory=MiddlewareEnvironment)
    variables_of: Callable[[str | None, Path], Mapping[str, str]] | None = None
    describe_installed: Callable[[], str] | None = None
    own_causes: Callable[[NodeOptions, str | None, Mapping[str, str]], Iterable[str]] = lambda *_: ()
    profile_of: Callable[[str | None, Mapping[str, str]], tuple[str, str]] = lambda _rmw, _environment: ("", "")
    check_settings: Callable[[NodeOptions], None] | None = None
    missing_rmw: Callable[[str], str | None] | None = None

    def open_node(self, options: NodeOptions) -> Node:
        """Open a node that has joined the domain and is not started.

        Raises:
            BackendUnavailableError: the middleware or its licence is missing.
            OptionError: an option has no effect here.
        """
        self.check(options)
        try:
            with watched_configuration(self.label, self.environment):
                return self.make_node(options)
        except ImportError as err:
            raise BackendUnavailableError(f"{self.label} cannot be loaded ({err}); {self.install}") from err

    def open_pair(self, options: NodeOptions) -> tuple[Node, Node]:
        """Open a node that subscribes and one that publishes to it, maybe the same; errors as for `open_node`."""
        if self.make_pair is None:
            node = self.open_node(options)
            return node, node
        self.check(options)
        return self.make_pair(options)

    def check(self, options: NodeOptions) -> None:
        """Refuse options that would have no effect."""
        check_domain_id(options.domain_id)
        for fault in self._faults(options):
            raise OptionError(fault)
        self.own_variables(options)
        if options.peers and self.meeting is Meeting.DISCOVERY:
            raise OptionError(f"--peer {options.peers[0]}: the backend {self.name} discovers its peers; remove --peer")
        if self.check_settings is not None:
            self.check_settings(options)

    def _faults(self, options: NodeOptions) -> Iterator[str]:
        if options.rmw is not None and not self.has_ros:
            yield f"--rmw {options.rmw}: the backend {self.name} has no ROS middleware; leave it out"
        if options.executor is not ExecutorKind.AUTO and not self.has_ros:
            yield f"-o executor={options.executor.value}: the backend {self.name} has none; leave it out"
        control = options.congestion_control
        if control is not None and not self.has_congestion_control:
            yield f"-o congestion_control={control}: the backend {self.name} has no TCP of its own; leave it out"
        yield from self._faults_of_sending(options)
        over = f" over {options.transport.value}" if self.sizes and options.transport is not Transport.DEFAULT else ""
        for name, size in options.sizes._asdict().items():
            if size is not None and name not in self.sizes.get(options.transport, ()):
                yield f"-o {name}={size}: the backend {self.name}{over} has no such size; leave it out"
        if options.transport not in self.transports:
            names = ", ".join(transport.value for transport in self.transports)
            yield f"-o transport={options.transport.value}: the backend {self.name} only has {names}"
        if options.security not in (Security.OFF, *self.security):
            levels = ", ".join(level.value for level in (Security.OFF, *self.security))
            yield f"-o security={options.security.value}: the backend {self.name} only has {levels}"
        if options.security is not Security.OFF and self.speaks_dds and options.domain_id > LAST_SECURED_DOMAIN:
            yield f"--domain {options.domain_id}: secured domains are at most {LAST_SECURED_DOMAIN}; choose another"

    def _faults_of_sending(self, options: NodeOptions) -> Iterator[str]:
        if options.priority is not None and options.priority not in (self.priorities or ()):
            allowed = "none" if self.priorities is None else f"{self.priorities[0]} to {self.priorities[-1]}"
            yield f"-o priority={options.priority}: the priorities of the backend {self.name}: {allowed}"
        if options.when_full is not WhenFull.DEFAULT and not self.can_drop:
            yield f"-o when_full={options.when_full.value}: the backend {self.name} has no such choice; leave it out"
        if not options.multicast and not self.can_multicast:
            yield f"-o multicast=false: the backend {self.name} sends no message to a group; leave it out"
        call = f"-o call={options.call.value}"
        if options.call not in (Call.NONE, *self.calls):
            allowed = ", ".join(kind.value for kind in self.calls) or "none; use ros2 or zenoh"
            yield f"{call}: the calls of the backend {self.name}: {allowed}"
        elif options.call is not Call.NONE and (options.priority, options.when_full) != (None, WhenFull.DEFAULT):
            yield f"{call}: -o priority and -o when_full are of publishers; remove them"

    def own_variables(self, options: NodeOptions) -> Mapping[str, str]:
        """Return the variables that give the middleware the file of `--configuration`; refuse one that cannot be read."""
        path = options.configuration
        if path is None:
            return {}
        try:
            read_regular(path)
        except OSError as err:
            raise OptionError(f"--configuration {path}: {err.strerror}; give an existing file") from err
        variables = {} if self.variables_of is None else self.variables_of(options.rmw, path.absolute())
        if not variables:
            raise OptionError(f"--configuration: no file of {options.rmw or self.label} is known here; leave it out")
        return variables

    def port_of(self, domain_id: int) -> int:
        assert self.relay_port is not None
        return first_port(domain_id) + self.relay_port

    def describe_meeting(self, domain_id: int, dds_backends: str) -> str:
        port = "" if self.relay_port is None else self.port_of(domain_id)
        ports = domain_port_range(domain_id)
        return self.meeting_needs.format(port=port, ports=f"{ports[0]} to {ports[-1]}", dds_backends=dds_backends)

    def peer_addresses(self, options: NodeOptions) -> tuple[tuple[str, int], ...]:
        """Return host and port of each relay that a ping connects to; an `OptionError` for a wrong or missing one."""
        port = self.port_of(options.domain_id)
        if options.discovery is Discovery.LOCALHOST and not options.peers:
            return (("127.0.0.1", port),)
        if not options.peers:
            raise OptionError(
                f"the backend {self.name} does not look for relays on the network: give the relay's device with "
                "--peer HOST, or --discovery localhost if it is on this one"
            )
        return tuple(_parse_address(text, port) for text in options.peers)


def has_package(name: str) -> bool:
    """Return whether a package is installed, without importing it."""
    return find_spec(name) is not None


def _parse_address(text: str, default_port: int) -> tuple[str, int]:
    host, colon, number = text.rpartition(":")
    if limits.HOST.fault(text) is not None:
        raise OptionError(f"--peer {limits.shown(text)}: write HOST or HOST:PORT")
    if not colon:
        return text, default_port
    if limits.ADDRESS.fault(text) is not None or limits.PORT.fault(int(number)) is not None:
        raise OptionError(f"--peer {text}: write HOST or HOST:PORT")
    return host, int(number)
