"""From events to rows, one per message, and from rows to Parquet.

- `exchanges`, `sessions`, `flows`: which ping and relay exchanged messages, and under which load.
- `pair`, `unsent`, `counts`: the fate of each message.
- `one_way`, `utc`: clocks.
- `roundtrips`, `parquet`, `rows`, `provenance`: the rows and their files.
"""
