"""From a stamped event to an `.mcap` file on disk."""
