"""Recorder and analyzer for the latency of ROS 2 / DDS communication.

The rooms of this package lie at the top level of the repository; the links beside this file give them their one import
name. A wheel holds the folders themselves.
"""
