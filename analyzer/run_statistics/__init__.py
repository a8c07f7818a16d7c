"""Statistics of a group of runs, where a run is one observation: numpy in, frozen records out, in the unit of the values.

- `runs`: a run, the runs of a group, and a statistic of them; `tails`, `bursts`: how much dependent messages are worth.
- `between_runs`: the interval of a statistic; `change`: its change between two sides; `received`: both of a received ratio.
- `spread`: variance between and within runs, and how many runs decide; `batching`: the same for several groups, for speed.
- `late_share`: the share of messages later than a deadline; `two_samples`: tests of two means; `modes`: warm-up, trend and modes of one run.
"""
