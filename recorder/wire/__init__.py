"""What a message costs on the wire: packets of the run's interfaces, counted by class and followed by message.

`WireCapture` starts a process that watches interfaces (`process`): a `ring` that the kernel fills gives frames, whose headers
(`packets`) a `tally` turns into `WireCounts` and rows of messages. What the kernel counts itself stands beside it (`kernel_counters`, `tcp_info`).
"""
