"""What earlier campaigns measured, and a model of it that answers for sizes and rates that nobody measured."""
