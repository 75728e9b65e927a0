"""What travels: points, meshes, and places on a lattice; imports nothing else of the surface."""
