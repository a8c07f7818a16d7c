"""What the kernel reports: counters, limits and groups of a network namespace, its sockets, and the state of TCP."""
