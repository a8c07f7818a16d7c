"""Campaigns: plans, sweeps on several devices and links, searches over settings."""
