"""Compiled decoders of others, in a process whose end and whose time are survived."""
