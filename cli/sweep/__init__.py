"""`dds-sweep`: its command, what it shows instead of sweeping, and `dds-sweep new`."""

from .command import main

__all__ = ["main"]
