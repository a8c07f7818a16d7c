"""A recording that lasts for weeks: rotated files, free space on the disk, reports to systemd and to `dds-record status`."""
