"""A running sweep: its runner, state, results and progress."""
