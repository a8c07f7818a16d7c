"""The middlewares: one file for each API, loaded at use."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from dds_trace.base.errors import OptionError

if TYPE_CHECKING:
    from .base import Backend
    from .node import Node, NodeOptions

BACKEND_MODULES = {
    "ros2": "dds_trace.recorder.backends.ros2",
    "cyclonedds": "dds_trace.recorder.backends.cyclonedds",
    "zenoh": "dds_trace.recorder.backends.zenoh",
    "connext": "dds_trace.recorder.backends.connext",
    "socket": "dds_trace.recorder.backends.socket",
}


def load_backend(name: str) -> Backend:
    if name not in BACKEND_MODULES:
        raise OptionError(f"there is no backend {name!r}; choose one of {', '.join(BACKEND_MODULES)}")
    backend: Backend = import_module(BACKEND_MODULES[name]).BACKEND
    return backend


def load_backends() -> tuple[Backend, ...]:
    return tuple(map(load_backend, BACKEND_MODULES))


def open_node(name: str, options: NodeOptions) -> Node:
    return load_backend(name).open_node(options)


def installed_middlewares() -> list[tuple[str, str | None]]:
    """Return (backend, rmw) of every middleware on this machine; rmw None means the environment's."""
    return [(backend.name, rmw) for backend in load_backends() for rmw in backend.find_installed()]
