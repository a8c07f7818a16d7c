"""The bridges between two DDS domains: one file for each, launched and supervised, never imported by a role."""
