"""The recorder's device and process."""
