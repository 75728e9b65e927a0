"""One job of surface reconstruction, from its points to its mesh and its report.

::

    run ──> steps ──> backend selection, resolution, (pipeline), diagnostics
     ├────> carry          what the mesh carries, and its output
     └────> report page
"""
