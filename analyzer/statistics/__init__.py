"""Statistics of samples, in pure numpy.

- `percentiles`: quantiles, the summary of a metric, how many messages a percentile takes, ranks that enclose a quantile.
- `histogram`: mergeable counts in log-linear buckets.
- `intervals`: an estimate with its interval, and what that rests on.
- `distributions`: Student's t, the power of its test, exact limits of a Poisson count.
- `power`: the smallest detectable change, how much more it takes to decide, and p values of many tests.
"""
