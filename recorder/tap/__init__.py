"""The role tap: listens to topics of other programs.

- tap: joins topics as they appear, and stores an event for each message
- streams: one publisher's messages: counts, rate, silence
- stamps: the header stamp of messages of any type
- page: the live table for others, as a local web page and as `diagnostic_msgs`
- recording: a tap's recording from its options to a closed trace
"""
