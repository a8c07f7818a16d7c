"""Reports of a comparison: `info` puts it into words, `words` formats numbers, the others `render` it."""
