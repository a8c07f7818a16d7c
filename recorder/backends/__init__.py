"""The middlewares that messages can travel on: one file for each API, loaded when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from dds_trace.tracefile import OptionError

if TYPE_CHECKING:
    from .base import Backend, Node, NodeOptions

BACKEND_MODULES = {
    "ros2": "dds_trace.recorder.backends.ros2",
    "cyclonedds": "dds_trace.recorder.backends.cyclonedds",
    "zenoh": "dds_trace.recorder.backends.zenoh",
    "connext": "dds_trace.recorder.backends.connext",
    "socket": "dds_trace.recorder.backends.socket",
}
"""Name of each backend and the module that holds its `BACKEND`."""


def load_backend(name: str) -> Backend:
    """The backend called `name`; its middleware is imported when the first node is opened.

    Raises:
        OptionError: there is no such backend.
    """
    if name not in BACKEND_MODULES:
        raise OptionError(f"there is no backend {name!r}; choose one of {', '.join(BACKEND_MODULES)}")
    backend: Backend = import_module(BACKEND_MODULES[name]).BACKEND
    return backend


def open_node(name: str, options: NodeOptions) -> Node:
    """A node on the backend called `name`; errors as for `load_backend` and `Backend.open_node`."""
    return load_backend(name).open_node(options)


__all__ = ["BACKEND_MODULES", "load_backend", "open_node"]
