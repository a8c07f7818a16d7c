"""Recordings that are not ours: rate, gaps, jitter, size and age of every topic.

- `messages`: the messages of rosbag1, rosbag2 and MCAP files, without their content.
- `topics`: the statistics of each topic.
"""
