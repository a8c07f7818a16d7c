"""A running sweep: runner, state, results and progress."""
