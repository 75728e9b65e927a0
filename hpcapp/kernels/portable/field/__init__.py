"""The implicit function over bricks: quadrics blended, edges and corners, the far field."""
