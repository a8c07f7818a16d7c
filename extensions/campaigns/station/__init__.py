"""Where cells run: devices, programs, network namespaces and emulated links."""
