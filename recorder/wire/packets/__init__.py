"""Packets by their headers only: pure functions over bytes, and the program that the kernel runs over each.

`packet_filter` selects frames and how much of them is captured; `frames` reads Ethernet, IP, UDP and TCP headers, `rtps`
the submessages of a packet, `fragments` those in later IP fragments; `classes` names the purpose of bytes.
"""
