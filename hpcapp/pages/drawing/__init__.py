"""Pictures without a graphics library: a camera, a depth buffer in numpy, light and shadow.

::

    positions ── Camera ──> screen ── DepthBuffer, a band of rows at a time ──> shades ── light ──┐
                                                     the ground below ── GroundShadow ──> a picture

A picture is drawn `SAMPLES` times finer and averaged down, which smooths its outlines. Memory is
that of the screen coordinates, of one band and of the picture.
"""
