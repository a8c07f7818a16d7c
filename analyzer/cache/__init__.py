"""Traces and the user's cache."""
