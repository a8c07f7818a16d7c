"""Pages and pictures that follow a recording or are in a notebook."""
