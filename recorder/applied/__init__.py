"""What a middleware process really uses, read back from the kernel (Linux only).

It is read before the first message and after the last one, never between messages.
"""
