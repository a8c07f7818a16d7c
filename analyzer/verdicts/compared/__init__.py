"""What a comparison is made of: its rows, the columns that it may leave out, and what its verdicts would have seen."""
