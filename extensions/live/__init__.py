"""Pages and pictures that follow a recording or are in a notebook."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(commands={"watch": "command:app"}, parts={"presenter": "notebook"})
