"""Topics of a running robot: tap, beacon, chains."""
