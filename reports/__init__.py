"""Pages and tables drawn from an `Analysis`; nothing is computed here."""

from .html.page import live_script, render_live
from .reporters import REPORTERS, Reporter, write_report

__all__ = ["REPORTERS", "Reporter", "live_script", "render_live", "write_report"]
