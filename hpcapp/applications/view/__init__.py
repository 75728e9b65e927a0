"""Meshes and points on a page: the command ``view``."""
