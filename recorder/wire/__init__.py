"""What a message costs on the wire: packets of the run's interfaces, by class and by message.

`WireCapture` starts a process (`process`) that captures frames from a `ring` that the kernel fills; `tally` turns their
headers (`packets`) into `WireCounts` and rows of messages.
"""
