"""MCAP files as bytes: records, chunks, channels and summaries, in order."""
