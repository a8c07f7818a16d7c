"""Round trips for other programs: CSV, Arrow, and MCAP for Foxglove."""
