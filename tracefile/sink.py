"""Where a recording node puts its events: `TraceSink` (interface frozen here; the inside is issue 3's)."""
