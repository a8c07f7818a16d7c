"""Packets on the wire: capture, what a message costs there, what was sent again."""
