"""What is asked of points and meshes: a box, a ball, a polygon, classes, the bare ground."""
