"""What a middleware process really uses, read back from the kernel before the first message and after the last (Linux only)."""
