"""The ping and relay roles that stamp T1-T4 and hand them to a trace."""
