"""The ping and the relay, from the plan of a run to its last reply."""
