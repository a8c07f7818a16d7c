"""The role beacon: compares the clocks of all devices that run one, by messages that all of them send and answer.

- estimate: difference and drift of two clocks, from round trips so far
- exchange: the four stamps of a round trip, put together from both sides
- time_service: what chrony or timedatectl say of this device's clock
- recording: a beacon's recording from its options to a closed trace
"""
