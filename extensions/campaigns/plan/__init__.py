"""Plans: cells, their order, the link and the duration."""
