"""The version, written into every trace's library field."""

__version__ = "0.2.0"
