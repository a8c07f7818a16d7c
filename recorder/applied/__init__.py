"""What a middleware process really uses, read back from the kernel (docs/reference/middlewares.md; Linux only)."""
