"""Traces in, one frozen `Analysis` out."""
