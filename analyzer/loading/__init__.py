"""The traces of a folder as one campaign (`campaign`), and the paths where they are (`place`)."""
