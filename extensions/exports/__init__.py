"""Formats of other programs: dashboards, trace viewers, histories."""
