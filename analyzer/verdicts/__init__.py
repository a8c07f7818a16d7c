"""What follows from groups: answers, comparisons, gates, bridge costs, recommendations."""
