"""Errors of a recording, each with its exit code."""

from __future__ import annotations

from dds_trace.base.errors import TraceError


class NoEchoError(TraceError):
    exit_code = 8


class NothingHeardError(TraceError):
    """No message came to a tap, or no answer to a beacon."""

    exit_code = NoEchoError.exit_code


class StoppedError(TraceError):
    exit_code = 130  # as shells report Ctrl-C


class NotAppliedError(TraceError):
    """The middleware does not use a requested setting, under `-o strict=true`."""

    exit_code = 11  # 10 is an incomplete sweep


class RelayLostError(TraceError):
    exit_code = 12


class LossesError(TraceError):
    """Run that lost more messages than `--fail-if-lost` allows."""

    exit_code = 13


class BridgeError(TraceError):
    """A bridge's program ended, did not come up, or cannot start; the text has the program's last line."""

    exit_code = 9
