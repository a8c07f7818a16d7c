"""Pages and tables drawn from an `Analysis`; nothing is computed here."""

from dds_trace.reports.html.page import live_script, render_live
from dds_trace.reports.reporters import REPORTERS, Reporter, write_report

__all__ = ["REPORTERS", "Reporter", "live_script", "render_live", "write_report"]
