"""A master that is not on the head: its workers' way to it."""
