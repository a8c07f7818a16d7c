"""The whole parameter space from one plan: cells, their order, the devices, the link between them, the state."""
