"""Points that are repeated, far, or belong to no surface, and normals the wrong way round."""
