"""What is said of each group of round trips: statistics, intervals, breakdown, freshness, timeline."""
