"""Steps of a job before and after its method: one module each.

::

    read ─> (method) ─> crop, pieces, simplify, texture ─> carry ─> diagnostics, report, report page
"""
