"""What `dds-trace bag` reports of recordings."""
