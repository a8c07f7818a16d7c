"""A recording as a service: rotated files, status, upkeep."""
