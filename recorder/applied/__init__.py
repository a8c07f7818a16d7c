"""What a middleware process really uses, read back from the kernel (Linux only).

`roles` reads before the first message and after the last one, never between messages. The result is in the session
(docs/trace-format.md), from which the analyzer makes findings.
"""
