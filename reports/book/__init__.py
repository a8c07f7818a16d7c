"""What a report says, worked out once from an `Analysis`: groups, values, curves, answer, overview."""
