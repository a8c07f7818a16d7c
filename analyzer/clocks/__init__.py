"""Clocks of two devices from the stamps of messages, in pure numpy."""
