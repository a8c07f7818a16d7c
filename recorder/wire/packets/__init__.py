"""Packets by their headers only: pure functions over bytes, and the program that the kernel runs over each."""
