"""Keys for DDS Security and TLS, made for one measurement and removed after it."""
