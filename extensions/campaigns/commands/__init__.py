"""The commands of campaigns, one file each."""
