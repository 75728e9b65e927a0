"""One job of surface reconstruction: what its pipeline stands on.

::

    settings ─> storage, folder, backend choice ─> site      where it runs
    columns ─> scan <─ resume                                what it runs on
    outcome                                                  what comes of it
"""
