"""The parts of a node that all backends share: its thread, the error that ended it, and how it is closed."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from typing_extensions import Self

    from .node import Middleware, NodeOptions

ROUND_S = 0.1
"""Longest round of a node's thread, and so the longest time for which `close` waits for it."""
LAST_ACKNOWLEDGEMENT_S = 0.5
"""Longest wait of a closing publisher: a participant that leaves at once takes its last messages with it."""


class OpenNode(ABC):
    """The part of a `Node` that is the same on every middleware, whoever owns its threads.

    Args:
        options: options that the node is opened with.

    Attributes:
        error: the exception that ended a thread, None while all is well.
    """

    _middleware: Middleware
    """Set by each backend as soon as the middleware runs."""

    def __init__(self, options: NodeOptions) -> None:
        self._options = options
        self._closing = False
        self.error: BaseException | None = None

    @property
    def options(self) -> NodeOptions:
        """Options that the node was opened with."""
        return self._options

    @property
    def middleware(self) -> Middleware:
        """The software that carries the messages."""
        return self._middleware

    def close(self) -> None:
        """Stop receiving, send what is still held, leave the domain; a second call does nothing."""
        if not self._closing:
            self._closing = True
            self._stop_receiving()
            self._leave()

    @abstractmethod
    def _stop_receiving(self) -> None:
        """End the threads that call the subscriptions."""

    @abstractmethod
    def _leave(self) -> None:
        """Send what is still held and leave the domain; no subscription is called any more."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class ThreadedNode(OpenNode):
    """A node with one thread of ours that waits for messages and calls the subscriptions."""

    def __init__(self, options: NodeOptions) -> None:
        super().__init__(options)
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread that calls the subscriptions."""
        name = f"{self.middleware.backend}-domain-{self.options.domain_id}"
        self._thread = threading.Thread(target=self._receive_until_closed, name=name, daemon=True)
        self._thread.start()

    def _receive_until_closed(self) -> None:
        try:
            receive_round = self._make_round()
            while not self._closing:
                receive_round()
        except BaseException as error:  # noqa: BLE001 - kept for whoever looks at the node; a thread has no caller
            self.error = error

    @abstractmethod
    def _make_round(self) -> Callable[[], None]:
        """Return the body of the thread's loop: it waits for at most `ROUND_S` and hands on what has arrived."""

    def _wake(self) -> None:
        """Cut the thread's current wait short, where the middleware can."""

    def _stop_receiving(self) -> None:
        self._wake()
        if self._thread is not None:
            self._thread.join()


@dataclass(frozen=True, slots=True)
class NodeSubscription:
    """A subscription that its node takes off the topic.

    Attributes:
        close: takes it off; a second call does nothing.
    """

    close: Callable[[], None]


def has_package(name: str) -> bool:
    """Tell whether a Python package is installed, without importing it."""
    return find_spec(name) is not None
