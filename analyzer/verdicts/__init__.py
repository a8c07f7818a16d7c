"""Verdicts on groups: answers, recommendations, comparisons, costs of bridges, gates.

- `cases`: the parts of a campaign that are judged together: kinds of message, and the contenders in them.
- `answers`: who is fastest for which kind of message.
- `job`, `recommend`, `interpolation`: which setting meets a deadline.
- `change`, `compare`, `bridge_cost`: what changed from one side to the other, and by how much.
- `compared`: what a comparison is made of, and what it would have seen.
- `gates`: conditions under which a comparison fails, for CI.
"""
