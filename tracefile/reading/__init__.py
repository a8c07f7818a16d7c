"""From trace files of any storage to events and descriptions."""
