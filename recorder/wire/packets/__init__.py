"""Packets, by their headers alone: pure functions over bytes, and the program that the kernel runs over each.

`packet_filter` says which frames are kept and how much of them; `frames` reads what all frames have (Ethernet, IP, UDP),
`rtps` the submessages of one packet, `fragments` those in later IP fragments, `tcp_flows` what TCP sends again; `classes`
names what bytes were sent for.
"""
