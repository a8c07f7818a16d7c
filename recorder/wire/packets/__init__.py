"""Packets by their headers only, and the program that the kernel runs over each."""
