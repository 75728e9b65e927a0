"""Terrain as heights over a lattice: what `compare --volume` and `heights` stand on."""
