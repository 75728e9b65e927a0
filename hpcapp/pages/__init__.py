"""What people look at: HTML pages that work without a network, and pictures without a GPU.

A page holds the mesh, the points beside it and its own program (three.js, `static/`); nothing is
loaded from elsewhere. This package knows meshes, points and numbers on them, and no application.
"""
