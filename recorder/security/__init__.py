"""Security of what is measured: keys for DDS Security and TLS, made for one measurement and removed after it.

`keys` makes the folder and what DDS signs, `tls` the two ends of a connection, `settings` of the middlewares.
"""
