"""Packets by their headers, and the program that the kernel runs over each."""
