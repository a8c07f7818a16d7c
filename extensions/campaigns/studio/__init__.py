"""`dds-trace studio`: one question and its answer, on a local page."""
