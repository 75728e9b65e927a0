"""From a field to triangles: bricks, marching cubes, and parts of a mesh."""
