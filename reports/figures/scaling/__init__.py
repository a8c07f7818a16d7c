"""Figures over payload size and rate."""
