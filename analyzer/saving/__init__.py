"""A saved analysis: a folder of checked files that is replaced as a whole (`docs/how-to/analyze.md`, "Save and load").

- `folder`: the files with their checksums, whatever they hold.
- `records`: everything of an analysis that is not a frame, as JSON.
"""
