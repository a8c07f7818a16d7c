"""What only campaigns decide: explanations, false alarms."""
