"""Meshes in files: a module per format."""
