"""Packets on the wire: capture, what a message costs there, what was sent again."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(
    checks={"capture": "ring:permitted"},
    details={"wire": "analyze:wire_frames"},
    figures={"wire": "figures:FIGURES"},
    findings={"wire": "findings:CHECKS"},
    parts={"wire": "capture:open_wire"},
)
