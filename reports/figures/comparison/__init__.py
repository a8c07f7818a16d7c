"""Figures that set vendors, domains and bridges beside each other."""
