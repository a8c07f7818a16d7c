"""The traces of a folder as one campaign, and the paths where they are."""
