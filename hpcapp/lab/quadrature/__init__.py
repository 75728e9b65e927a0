"""Adaptive quadrature: a second application, and the tutorial's."""
