"""`dds-trace sweep`, `capacity`, `explain` and `advise`: what is done with a plan."""
