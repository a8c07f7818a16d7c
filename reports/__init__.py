"""Pages and tables drawn from an `Analysis`; nothing is computed here."""

from reports.reporters import REPORTERS, Reporter, write_report

__all__ = ["REPORTERS", "Reporter", "write_report"]
