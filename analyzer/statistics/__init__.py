"""Statistics of samples and series, in pure numpy: percentiles, histograms, confidence intervals, the bootstrap.

- `percentiles`: quantiles, the summary of a metric, and how many messages each percentile takes.
- `histogram`: mergeable counts in log-linear buckets.
- `dependence`: how many messages count as one, because neighbours are alike.
- `intervals`: confidence intervals by order statistics, and of a share.
- `bootstrap`: what has no order statistics: a difference or ratio of two samples.
"""
