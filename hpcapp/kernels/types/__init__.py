"""What kernels take and give: grids, fields, and the parts of a mesh in bricks."""
