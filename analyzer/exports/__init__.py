"""Round trips for other programs: CSV, Arrow, MCAP for Foxglove."""
