"""Surface reconstruction: oriented points in, a watertight mesh out."""
