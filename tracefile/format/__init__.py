"""What a trace holds: events, session and run descriptions, the ring's slots, checksums."""
