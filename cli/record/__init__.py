"""`dds-record`: its words, values and commands."""

from dds_trace.cli.record.command import main

__all__ = ["main"]
