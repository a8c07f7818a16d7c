"""Statistics of samples, in pure numpy: percentiles, histograms, what an interval is, Student's t and its power.

- `percentiles`: quantiles, the summary of a metric, and how many messages each percentile takes.
- `histogram`: mergeable counts in log-linear buckets.
- `order_statistics`: the ranks that enclose a quantile.
- `intervals`: an estimate with its interval, and what that rests on; `run_statistics` computes them.
- `distributions`: Student's t, the power of its test, exact limits of a Poisson count.
- `power`: the smallest change that could have been found, and how much more it takes to decide.
- `families`: p values of many tests.
"""
