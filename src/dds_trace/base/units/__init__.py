"""The one parser and the one printer of each unit."""
