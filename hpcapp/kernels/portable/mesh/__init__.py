"""Meshes as they are handed over: connectivity, seams of parts, fewer faces."""
