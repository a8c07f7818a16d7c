"""Recordings of any program, read as far as they are whole: MCAP, rosbag2's SQLite, rosbag1."""
