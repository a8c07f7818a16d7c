"""A sweep at work: its runner, state, lock, results and progress."""
