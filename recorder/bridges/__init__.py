"""Bridges between two DDS domains: one file for each, their record in `base`, running programs in `process`."""
