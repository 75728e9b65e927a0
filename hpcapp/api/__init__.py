"""The interface for Python: what ``import hpcapp`` gives.

::

    arrays, clouds, files ── checked ─> the command's own steps ─> Mesh, Comparison, PointCloud
"""
