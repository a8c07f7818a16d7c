"""Events of one exchange to rows, one a message, and rows to Parquet."""
