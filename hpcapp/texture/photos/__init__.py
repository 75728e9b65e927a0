"""Colours of a mesh from photographs whose cameras are known.

::

    folder, cameras ─> photos ─┬─> view: what one sees of the mesh ─┐
                               └─> picture: what one shows ─────────┴─> best looks of each texel
        ─> exposures, levelled where two see a texel ─> colours

One photograph is in memory at a time.
"""
