"""Recordings at the terminal."""
