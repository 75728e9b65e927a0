"""Whose a cluster is: its keys, and the journal of what was done to it."""
