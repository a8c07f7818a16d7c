"""Verdicts on groups.

- `cases`: kinds of message, each judged by itself, and the setups compared in each.
- `matching`: which groups of two sides are compared, and their messages.
- `answers`, with `ranking`: which setup is fastest for which kind of message, and which differ.
- `job`, `recommend`: which setup meets a deadline.
- `compare`, with `comparison_rows`, `ignoring`, `sides`: what changed; `bridge_cost`: through a bridge.
- `false_alarms`: how often a comparison of equal sides is wrong, and how precise a statistic is.
- `gate`, `gates`: conditions under which a comparison fails, for CI.
"""
