"""Traces of all devices in one campaign of events, read once and kept."""
