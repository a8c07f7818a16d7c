"""From events to rows, one per message, and from rows to Parquet."""
