"""Recordings of other programs: read them, say what is missing, recover them."""
