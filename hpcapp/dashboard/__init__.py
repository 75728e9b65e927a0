"""A page that shows a job while it runs, and what a Prometheus server reads; see `open_dashboard`.

::

    job ── stages, parts ──> WatchedJob <── looks twice a second ── server's thread ──> pages
        └─ tasks ──> Timeline ──┘                                        (each at its own pace)

The job writes into plain lists and waits for nobody. Starlette and uvicorn are imported when a
dashboard is opened.
"""

__all__ = ["DEFAULT_ADDRESS"]

DEFAULT_ADDRESS = "127.0.0.1:0"
"""Any free port of loopback."""
