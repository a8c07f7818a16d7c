"""`dds-record`: its words, values and commands."""

from .command import main

__all__ = ["main"]
