"""Whether a test can make network namespaces here."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import count

import pytest

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.extensions.campaigns.station.emulation import ip

_numbers = count()


@contextmanager
def network_with(interface: str, *commands: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """A network namespace with an interface that has the address 198.51.100.1; yields the way into it."""
    name = f"ddstrace-{interface}-{os.getpid()}-{next(_numbers)}"
    ip("netns", "add", name)
    try:
        for command in (
            ("link", "set", "lo", "up"),
            ("link", "add", interface, "type", "veth", "peer", "name", "peer0"),
            ("addr", "add", "198.51.100.1/24", "dev", interface),
            ("link", "set", interface, "up"),
            ("link", "set", "peer0", "up"),
            *commands,
        ):
            ip("-n", name, *command)
        yield ("ip", "netns", "exec", name)
    finally:
        ip("netns", "delete", name)


def needs_namespaces(program: str, package: str) -> pytest.MarkDecorator:
    """Skips a test by name where namespaces, or a program that it uses in them, are missing."""
    reason = _reason_to_skip(program, package)
    return pytest.mark.skipif(reason is not None, reason=str(reason))


@cache
def _reason_to_skip(program: str, package: str) -> str | None:
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which(program, path=os.environ["PATH"] + ":/usr/sbin:/sbin") is None:
        return f"{program} ({package}) is not installed"
    probe = f"ddstrace-probe-{os.getpid()}"  # test processes side by side try at the same time
    try:
        ip("netns", "add", probe)
        ip("netns", "delete", probe)
    except BackendUnavailableError as err:
        return f"no network namespaces here: {err}"
    return None
