"""A recording as a service: rotated files, status, upkeep."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(commands={"record status": "command:app"}, parts={"upkeep": "upkeep:Upkeep"})
