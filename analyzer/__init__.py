"""Traces in, one frozen `Analysis` out.

    from dds_trace import analyze
    a = analyze("runs/")  # a.summary, a.load_roundtrips() ... are polars frames

What the rooms above use; the names for users are on the page of `dds_trace`.
"""
