"""Pages and tables drawn from an `Analysis`; nothing is computed here."""

from .reporters import REPORT_MODULES, Reporter, load_reporter, render_report, write_reports

__all__ = ["REPORT_MODULES", "Reporter", "load_reporter", "render_report", "write_reports"]
