"""Plans: which cells there are, in which order, over which link, and how long they take."""
