"""A recording of weeks: rotation, disk space, reports to systemd and `dds-trace record status`."""
