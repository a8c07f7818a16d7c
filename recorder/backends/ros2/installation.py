"""This machine's ROS 2, without importing it."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import psutil

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.limits import nearest
from dds_trace.base.printable import printable

from ...applied.asked import file_text, read_profile_request
from ...applied.vendors import VENDORS, ros_middleware
from ...choices import Discovery, Transport
from ...domains import FIRST_PARTICIPANT, domain_port_range
from ...host.child import Child
from ...kernel.sockets import closed_ports
from ...security.keys import enclave
from ..base import has_package
from ..node import Middleware, NodeOptions
from ..qos import requested_durations

WRONG_RMW_TIMEOUT_S = 30.0
WHEELS_RMW = "rmw_fastrtps_cpp"
RMW_INDEX = Path("share/ament_index/resource_index/rmw_typesupport")

INSTALL = (
    "pip install 'dds-trace[ros2]' (in a clone '.[ros2]') (wheels, x86_64), or install ROS 2 from apt and run "
    "`source /opt/ros/$ROS_DISTRO/setup.bash` in this terminal (the Python of that ROS 2 must run dds-trace)"
)

NO_TUNING = (
    "--tuned has no effect with -o transport={}: it enlarges the buffers of UDP sockets, which do not carry the messages "
    "there; leave one of the two options out"
)


def find_rmws() -> Sequence[str | None]:
    if not has_package("rclpy"):
        return []
    names = {file.name for prefix in _prefixes() for file in Path(prefix, RMW_INDEX).glob("rmw_*")}
    return sorted(names) or [None]  # wheels have no index


def describe_installed() -> str:
    names = (re.fullmatch(r"ros-([a-z]+)-rclpy", dist.metadata["Name"] or "") for dist in metadata.distributions())
    distro = os.environ.get("ROS_DISTRO") or next((match[1] for match in names if match), "")
    rmws = [_described(rmw or WHEELS_RMW) for rmw in find_rmws()]
    return f"{distro.capitalize()}, rclpy {package_version('rclpy') or 'of unknown version'}; {', '.join(rmws)}".lstrip(
        ", "
    )


def _described(rmw: str) -> str:
    facts = ros_middleware(rmw)
    package = fast_dds().package if facts.vendor == "fastdds" else facts.packages[0]
    versions = {rmw: package_version(rmw), facts.label: package_version(package) if package != rmw else None}
    return " on ".join(f"{name} {version}" for name, version in versions.items() if version) or rmw


def missing_rmw(rmw: str) -> str | None:
    installed = find_rmws()
    if rmw in installed or (None in installed and rmw == WHEELS_RMW):
        return None
    return f"{rmw} is not here: apt install {_debian_name(rmw)}; the wheels only have Fast DDS"


def _debian_name(rmw: str) -> str:
    return f"ros-$ROS_DISTRO-{rmw.replace('_', '-')}"


def check_installed() -> None:
    if not has_package("rclpy"):
        raise BackendUnavailableError(f"ROS 2's Python client rclpy is not installed; {INSTALL}")
    rmw = os.environ.get("RMW_IMPLEMENTATION")
    if not rmw or "rclpy" in sys.modules:
        return
    # With a middleware that it was not built for, rclpy ends its process.
    script = "from rclpy.utilities import get_rmw_implementation_identifier as name; print(name())"
    completed = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=WRONG_RMW_TIMEOUT_S, check=False
    )
    running = completed.stdout.strip()
    if running != rmw:
        reason = (completed.stderr.strip().splitlines() or [f"{running} runs here"])[-1]
        raise BackendUnavailableError(
            f"RMW_IMPLEMENTATION={rmw} does not work here: {reason}; unset it or leave --rmw out, or install that middleware "
            f"(apt install {_debian_name(rmw)}; the wheels only have Fast DDS)"
        )


def set_discovery_range(discovery: Discovery) -> None:
    is_local = discovery is Discovery.LOCALHOST
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST" if is_local else "SUBNET"
    # Iron and later warn of the older variable; Humble knows only that.
    if find_spec("rclpy.event_handler") is None:
        os.environ["ROS_LOCALHOST_ONLY"] = "1" if is_local else "0"
    else:
        os.environ.pop("ROS_LOCALHOST_ONLY", None)


def set_security(options: NodeOptions) -> None:
    if options.keys is not None:
        enclave_name = enclave(options.keys, listens=options.listens)
        os.environ |= {
            "ROS_SECURITY_ENABLE": "true",
            "ROS_SECURITY_STRATEGY": "Enforce",
            "ROS_SECURITY_KEYSTORE": str(enclave_name.parents[1]),
            "ROS_SECURITY_ENCLAVE_OVERRIDE": f"/{enclave_name.name}",
        }


def set_transport(options: NodeOptions, rmw: str) -> None:
    requested = (options.transport.value, options.tuned)
    builtin = VENDORS["fastdds"].builtin_transports
    check_vendor(options, rmw)
    if requested not in builtin:
        raise OptionError(NO_TUNING.format(options.transport.value))
    if (value := builtin[requested]) is not None:
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = value


def check_settings(options: NodeOptions) -> None:
    if options.rmw is not None:
        check_vendor(options, options.rmw)


def check_vendor(options: NodeOptions, rmw: str) -> None:
    middleware = ros_middleware(rmw)
    if middleware.vendor != "fastdds":
        if options.transport is not Transport.DEFAULT:
            raise OptionError(
                f"-o transport={options.transport.value} is Fast DDS's, and the middleware here is {rmw}; leave it out"
            )
        if any(options.sizes):
            raise OptionError(
                f"-o buffer, -o segment and -o fragment are for Fast DDS, and the middleware here is {rmw}; leave them out"
            )
        if options.tuned:
            raise OptionError(
                f"--tuned: no settings for large messages of {rmw} are known here; leave it out, or set them in its own files"
            )
    if not middleware.has_durations:
        for policy in requested_durations(options.qos):
            raise OptionError(f"-o {policy}: {rmw} does not implement it; leave it out")


def package_version(package: str) -> str | None:
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(f"ros-{package.replace('_', '-')}")
    for prefix in _prefixes():
        for file, version in _VERSION_FILES:
            with suppress(OSError):
                if match := version.search(Path(prefix, file.format(package=package)).read_text()):
                    return match[1]
    return _debian_version(package)


_VERSION_FILES = (
    ("share/{package}/package.xml", re.compile(r"<version>\s*([^<\s]+)")),
    (
        "share/{package}/cmake/{package}Config-version.cmake",
        re.compile(r'set\(\s*PACKAGE_VERSION\s+"([^"]+)"', re.IGNORECASE),
    ),
)

DPKG_STATUS = Path("/var/lib/dpkg/status")


def _debian_version(package: str) -> str | None:
    distro = os.environ.get("ROS_DISTRO", "")
    name = f"ros-{distro}-{package.replace('_', '-')}"
    with suppress(OSError):
        pattern = rf"^Package: {re.escape(name)}\n(?:[^\n]+\n)*?Version: (?:\d+:)?([^\n-]+)"
        if distro and (match := re.search(pattern, DPKG_STATUS.read_text(errors="replace"), re.MULTILINE)):
            return match[1]
    return None


@dataclass(frozen=True, slots=True)
class FastDds:
    """What differs between Fast DDS 2 (Jazzy and before) and 3 (docs/reference/middlewares.md); the first variable that is set counts."""

    package: str
    profile_variables: tuple[str, ...]
    profile_file: str
    times: tuple[str, str, str]
    large_data: Mapping[str, int]


FAST_DDS_2 = FastDds(
    "fastrtps",
    ("FASTRTPS_DEFAULT_PROFILES_FILE",),
    "DEFAULT_FASTRTPS_PROFILES.xml",
    ("heartbeatPeriod", "nackResponseDelay", "heartbeatResponseDelay"),
    {},
)
FAST_DDS_3 = FastDds(
    "fastdds",
    ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"),
    "DEFAULT_FASTDDS_PROFILES.xml",
    ("heartbeat_period", "nack_response_delay", "heartbeat_response_delay"),
    {"segment_size": 8_704_000, "port_queue_capacity": 8_500},
)


@cache
def fast_dds() -> FastDds:
    return FAST_DDS_2 if package_version(FAST_DDS_3.package) is None else FAST_DDS_3


def profile_of(rmw: str | None, environment: Mapping[str, str]) -> tuple[str, str]:
    """Return the path of the profile that Fast DDS reads, and in words what it does not read; empty if there is none."""
    if ros_middleware(rmw or WHEELS_RMW).vendor != "fastdds":
        return "", ""
    running, other = (FAST_DDS_2, FAST_DDS_3) if fast_dds() is FAST_DDS_2 else (FAST_DDS_3, FAST_DDS_2)
    for path in (*map(environment.get, running.profile_variables), running.profile_file):
        if path and (path != running.profile_file or Path(path).is_file()):
            return path, ""
    ignored = [name for name in other.profile_variables if environment.get(name)]
    ignored += [f"./{other.profile_file}"] if Path(other.profile_file).is_file() else []
    names = f"{running.profile_variables[0]} or ./{running.profile_file}"
    version = package_version(running.package) or ""
    return "", f"{ignored[0]} is ignored: Fast DDS {version} reads {names}" if ignored else ""


def own_causes(options: NodeOptions, rmw: str | None, environment: Mapping[str, str]) -> Iterator[str]:
    """Yield what in these variables keeps a node from others, with what to do."""
    named = environment.get("RMW_IMPLEMENTATION", "")
    if named and named != WHEELS_RMW:
        yield f"RMW_IMPLEMENTATION is {named} here: the other side's has to be a middleware that it meets"
    if ros_middleware(rmw or WHEELS_RMW).vendor != "fastdds":
        return
    if server := environment.get("ROS_DISCOVERY_SERVER"):
        servers = filter(None, map(_SERVER.fullmatch, server.split(";")))
        closed = closed_ports((match[1], int(match[2] or 11811)) for match in servers)
        variables = " ".join(name for name in ("ROS_DISCOVERY_SERVER", "ROS_SUPER_CLIENT") if environment.get(name))
        yield (
            f"ROS_DISCOVERY_SERVER is {server} here{', and '.join(['', *closed])}: this process only meets those that ask the same server; "
            f"`unset {variables}`, or set it on both sides and start the server"
        )
    path, _ = profile_of(rmw, environment)
    interfaces = read_profile_request(file_text(path)).interfaces if path else ()
    present = {*psutil.net_if_addrs(), *(each.address for some in psutil.net_if_addrs().values() for each in some)}
    if interfaces and not present & {*interfaces}:
        yield (
            f"the whitelist of the profile {Path(path).name} only has {', '.join(interfaces)}, and no interface here has that name or "
            "address: correct it, or unset the variable that names the profile"
        )
    peers = environment.get("ROS_STATIC_PEERS", "")
    port = domain_port_range(options.domain_id)[FIRST_PARTICIPANT]
    if closed := closed_ports((peer.strip(), port) for peer in peers.split(";") if peer.strip()):
        yield (
            f"ROS_STATIC_PEERS is {peers} here, and {', and '.join(closed)}, where the first node of domain {options.domain_id} on a "
            "device listens: name the other side's device, and start its node"
        )
    has_profile = options.tuned or options.transport is not Transport.DEFAULT
    if peers and has_profile and options.discovery is Discovery.LOCALHOST:
        yield f"ROS_STATIC_PEERS is {peers} here, which -o transport and --tuned ignore under --discovery localhost: give --discovery subnet"
    if fast_dds() is FAST_DDS_3 and {*interfaces} - {"lo", "127.0.0.1"} and (machine_id := file_text(_MACHINE_ID)):
        yield (
            f"the profile {Path(path).name} has a whitelist, with which Fast DDS 3 meets no other device of the same {_MACHINE_ID} "
            f"(here {machine_id[:8]}...): compare them, and change one if they are alike, or take the whitelist out"
        )


_MACHINE_ID = "/etc/machine-id"
_SERVER = re.compile(r"\s*(?:UDPv4:)?\[?([^\[\]:]+)\]?(?::(\d{1,4}|[1-5]\d{4}|6[0-4]\d{3}))?\s*")
_INTERFACE = re.compile(r"[a-z][a-z0-9_]{0,99}/(?:msg|srv|action)/[A-Z][A-Za-z0-9]{0,99}")


@lru_cache(256)
def message_class(type_name: str) -> Any:
    """Return the class of an installed interface; a stranger's type name imports nothing else. A `BackendUnavailableError` for any other."""
    if _INTERFACE.fullmatch(type_name) is None:
        raise BackendUnavailableError(f"{printable(type_name, 80)} is not the name of a ROS 2 type (package/msg/Name)")
    package, kind, name = type_name.split("/")
    spec = find_spec(package)
    folders = [] if spec is None else spec.submodule_search_locations or []
    if any(list(Path(folder).glob(f"{package}_s__rosidl_typesupport_c*.so")) for folder in folders):
        with suppress(ImportError):
            classes = vars(import_module(f"{package}.{kind}"))
            if name in classes:
                return classes[name]
            names = [known for known in classes if known[:1].isupper()]
            raise BackendUnavailableError(f"{package} is here, and has no {kind}/{name}; {nearest(name, names)}")
    raise BackendUnavailableError(
        f"the message type {type_name} is not installed; apt install ros-$ROS_DISTRO-{package.replace('_', '-')}, or {INSTALL}"
    )


def find_program(package: str, program: str) -> Path | None:
    paths = (Path(prefix, "lib", package, program) for prefix in _prefixes())
    return next((path for path in paths if path.is_file() and os.access(path, os.X_OK)), None)


def _prefixes() -> list[str]:
    return [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]


PATIENCE_S = 10.0
_ENDPOINT = re.compile(r"connect/endpoints\s*=\s*\[\s*\"tcp/(?P<host>\[[^\]]+\]|[^:\"]+):(?P<port>\d{1,5})")


@dataclass(slots=True)
class Router:
    settings: Mapping[str, str] = field(default_factory=dict)
    process: Child | None = None

    def close(self) -> None:
        process, self.process = self.process, None
        if process is not None:
            process.end(PATIENCE_S)


def open_router(rmw: str, discovery: Discovery, patience_s: float = PATIENCE_S) -> Router:
    middleware = ros_middleware(rmw)
    if not middleware.router:
        return Router()
    host, port = _address(middleware.router_port)
    is_local = discovery is Discovery.LOCALHOST
    if _listens(host, port) or (not is_local and _comes_up(host, port, patience_s)):
        return Router({"router": "was running"})
    start = f"start it with `ros2 run {rmw} {middleware.router}`"
    missing = f"{rmw} needs its router, and none listens at {host}:{port}"
    if not is_local:
        raise BackendUnavailableError(f"{missing}; {start}, on each device, and connect the routers (docs of {rmw})")
    program = find_program(rmw, middleware.router)
    if program is None:
        raise BackendUnavailableError(
            f"{missing}; {middleware.router} is not installed here, so {start} elsewhere on this machine"
        )
    router = Router({"router": "started"}, _start(program, port))
    if not _comes_up(host, port, patience_s, router.process):
        has_ended = router.process is not None and router.process.poll() is not None
        router.close()
        fault = "ended at once" if has_ended else f"does not listen within {patience_s:g} s"
        raise BackendUnavailableError(f"{missing}; {program} {fault}: {start} and read its output")
    return router


def _address(port: int) -> tuple[str, int]:
    match = _ENDPOINT.search(os.environ.get("ZENOH_CONFIG_OVERRIDE", ""))
    return (match["host"].strip("[]"), int(match["port"])) if match else ("localhost", port)


def _listens(host: str, port: int) -> bool:
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def _comes_up(host: str, port: int, patience_s: float, process: Child | None = None) -> bool:
    end_s = time.monotonic() + patience_s
    while not _listens(host, port):
        if time.monotonic() > end_s or (process is not None and process.poll() is not None):
            return False
        time.sleep(0.05)
    return True


def _start(program: Path, port: int) -> Child:
    overrides = filter(None, (os.environ.get("ZENOH_CONFIG_OVERRIDE"), f'listen/endpoints=["tcp/localhost:{port}"]'))
    environment = {**os.environ, "ZENOH_CONFIG_OVERRIDE": ";".join(overrides)}
    return Child([program], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def describe_middleware(options: NodeOptions, rmw: str, executor: str, further: Mapping[str, str]) -> Middleware:
    facts = ros_middleware(rmw)
    versions = {name: package_version(name) for name in ("rclpy", *facts.packages)}
    segment_bytes = None
    if facts.vendor == "fastdds":
        versions["fastdds"] = package_version(fast_dds().package)  # one name for what two packages contain
        if options.transport is Transport.LARGE_DATA:
            segment_bytes = fast_dds().large_data.get("segment_size")
    settings = {
        "executor": executor,
        "discovery": options.discovery.value,
        "transport": options.transport.value,
        "tuned": str(options.tuned).lower(),
        "FASTDDS_BUILTIN_TRANSPORTS": os.environ.get("FASTDDS_BUILTIN_TRANSPORTS", ""),
        "segment_bytes": "" if segment_bytes is None else str(segment_bytes),
        **further,
    }
    return Middleware(
        "ros2",
        facts.vendor,
        rmw,
        {name: version for name, version in versions.items() if version},
        {name: value for name, value in settings.items() if value},
        facts.label,
    )
