"""Programs of bridges as processes: find, start, supervise, stop."""
