"""Machines out of a YAML cluster file."""
