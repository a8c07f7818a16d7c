"""The bridges between two DDS domains: one file for each, the record of one in `base`, its running programs in `process`."""
