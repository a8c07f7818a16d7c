"""The role tap: listens to topics of other programs.

- tap: joins topics as they appear, and stores an event for each message
- streams: one publisher's messages: counts, rate, silence
- stamps: the header stamp of messages of any type
- page: the same on a local web page
- diagnostics: the same as `diagnostic_msgs`
- worker: the thread that hashes and stores, at a low priority
- own_use: what a tap takes of the processor
- recording: a tap's recording from its options to a closed trace
"""
