"""What `dds-analyze --topics` reports of recordings: terminal, Markdown, JSON and a page, each from a `TopicReport`."""
