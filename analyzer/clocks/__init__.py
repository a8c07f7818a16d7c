"""Clock offset and drift between two devices, from the stamps alone; pure numpy."""
