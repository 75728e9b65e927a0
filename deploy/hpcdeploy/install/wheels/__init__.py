"""Which wheels a machine needs, and where they come from."""
