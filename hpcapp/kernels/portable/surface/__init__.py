"""From the function to triangles: bricks grown, marching cubes, vertices balanced."""
