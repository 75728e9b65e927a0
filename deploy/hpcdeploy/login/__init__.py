"""The way in to a machine: its keys, shells on it, and files to and from it."""
