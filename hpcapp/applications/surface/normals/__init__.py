"""Normals: whether they agree with their neighbours."""
