"""Traces and the user's cache.

- `store`: the cache folder, its keys and seals.
- `entries`, `events`: a trace in one file, with its events by stage, run and relay.
- `traces`, `loaded`, `remote`: load traces from the cache, from their files, or from object storage.
- `event_index`: which trace has which events.
"""
