"""What the kernel reports of a network namespace, its sockets and TCP."""
