"""What `dds-trace bag` reports of recordings: terminal, Markdown, JSON and a page, each from a `TopicReport`."""
