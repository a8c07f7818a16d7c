"""Statistics of a group of runs, where a run is one observation: numpy in, frozen records out."""
