"""What a message costs on the wire: packets of the run's interfaces, by class and by message."""
