"""Meshes of fewer triangles."""
