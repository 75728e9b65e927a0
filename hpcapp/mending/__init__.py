"""Meshes that are there: their holes filled, their small pieces dropped."""
