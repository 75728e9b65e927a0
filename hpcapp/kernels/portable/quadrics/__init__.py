"""Quadrics at the corners of cells: moments of points, fits to them, what parents hand down."""
