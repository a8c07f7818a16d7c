"""The version, written into every trace's library field."""

__version__ = "0.2.0"
YEAR = 2026
"""Of the release, for citations."""
