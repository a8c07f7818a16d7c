"""Pages and tables drawn from an `Analysis`; nothing is computed here."""
