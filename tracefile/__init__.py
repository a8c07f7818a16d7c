"""The contract between the devices that record and the machine that analyzes: one `.mcap` file."""
