"""Traces in, one frozen `Analysis` out: `pipeline.analyze`."""
