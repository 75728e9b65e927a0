"""LAS, LAZ and COPC: point clouds of laser scanners, plain and compressed."""
