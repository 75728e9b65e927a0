"""How far a mesh is from the truth: distances, F-scores, normals, topology."""
