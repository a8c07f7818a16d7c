"""Figures of how one group's values are spread."""
