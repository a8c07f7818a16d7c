"""Pages and tables drawn from an `Analysis`; nothing is computed here."""

from reports.page import live_script, render_live
from reports.reporters import REPORTERS, Reporter, write_report

__all__ = ["REPORTERS", "Reporter", "live_script", "render_live", "write_report"]
