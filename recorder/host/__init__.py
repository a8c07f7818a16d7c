"""The recorder's device and process: clocks, fingerprint, load, settings of the process, its own cost."""
