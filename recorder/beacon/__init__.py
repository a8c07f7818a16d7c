"""The role beacon: compares the clocks of all devices that run one, by messages that all of them send and answer."""
