"""Engines that others wrote, behind the Executor seam: Dask, Ray, MPI, and any Executor at all.

::

    submit ─> RetryingExecutor ── run_task, its arguments ──> the engine ──> a worker somewhere
                    ^                                             │
                    └── once more, where a worker was lost <──────┘

Each engine is one small module, imported when it is asked for; what they have in common is in
`retrying`. Used are submit, result, cancel and shutdown(wait=True), and positional arguments.
"""
