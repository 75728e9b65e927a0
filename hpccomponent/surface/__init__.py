"""Numeric kernels and value types of surface reconstruction: pure functions of arrays."""
