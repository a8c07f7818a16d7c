"""Errors of a recording, each with the exit code of `dds-record`."""

from __future__ import annotations

from dds_trace.base.errors import TraceError


class NoEchoError(TraceError):
    """Ping that no relay answered in time."""

    exit_code = 8


class StoppedError(TraceError):
    """Recording that was stopped (Ctrl-C, SIGTERM) before it had a message to send."""

    exit_code = 130  # as a shell has it of a program that Ctrl-C ended


class NotAppliedError(TraceError):
    """The middleware does not use a setting that was asked for, and the recording is strict about it."""

    exit_code = 11  # 10 is dds-sweep's: some cells have no recording


class RelayLostError(TraceError):
    """Relay that answered a ping and then, in the middle of its run, no more."""

    exit_code = 12


class LossesError(TraceError):
    """Run that lost a greater share of its messages than `--fail-if-lost` allows."""

    exit_code = 13


class BridgeError(TraceError):
    """Bridge whose program ended, never came up, or cannot be started; the text holds the program's last line."""

    exit_code = 9
