"""The machine that records: its fingerprint, its clocks, its load, and what recording costs on it."""
