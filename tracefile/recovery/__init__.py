"""Traces that a killed recorder left, made whole."""
