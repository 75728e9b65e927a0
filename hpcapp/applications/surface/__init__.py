"""Surface reconstruction: points in, a watertight mesh out."""
