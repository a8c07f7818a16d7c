"""A comparison: `info` puts it into words, `report` into blocks."""
