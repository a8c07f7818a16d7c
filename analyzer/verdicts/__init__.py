"""Verdicts on groups: answers, recommendations, comparisons, costs of bridges, gates.

- `cases`: kinds of message that are judged each by itself, and the setups compared in each.
- `matching`: which groups of two sides are compared, and their messages.
- `answers`: which setup is fastest for which kind of message.
- `job`, `recommend`: which setup meets a deadline.
- `compare`, with `comparison_rows`, `ignoring`, `sides`: what changed from one side to the other.
- `bridge_cost`: a comparison of each bridge with the same domain.
- `false_alarms`: how often a comparison of equal sides is wrong, and how precise a statistic is.
- `gate`, `gates`: conditions under which a comparison fails, for CI.
"""
