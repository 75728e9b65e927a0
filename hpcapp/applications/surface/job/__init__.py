"""One job of surface reconstruction: what its pipeline stands on.

::

    settings ─> storage, folder, backend choice ─> site      where it runs
    read, columns ─> scan <─ resume                          what it runs on
    outcome ─> diagnostics, simplify, carry                  what comes of it
        └────> report, report page
"""
