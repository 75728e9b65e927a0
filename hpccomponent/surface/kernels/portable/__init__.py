"""The kernels in numpy: the specification of the native ones."""
