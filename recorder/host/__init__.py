"""The recorder's device and process: clocks, fingerprint, load, settings, its own cost."""
