"""The role beacon: compares the clocks of all devices that run one, by messages that all of them send and answer.

- exchange: the four stamps of a round trip, put together from both sides
- recording: a beacon's recording from its options to a closed trace
"""
