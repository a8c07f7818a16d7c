"""Bridges between two DDS domains: a file for each."""
