"""A virtual range scanner over analytic shapes with known truth."""
