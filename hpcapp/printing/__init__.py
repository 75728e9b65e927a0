"""Meshes that are to be printed: closed, in one piece, on a flat base, in millimetres."""
