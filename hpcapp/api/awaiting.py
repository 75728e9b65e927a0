"""``await hpcapp.reconstruct_async``: a job in a thread, beside an event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from functools import partial, wraps
from typing import Any, ParamSpec, TypeVar

from hpcapp.api.reconstruction import reconstruct
from hpcapp.cancellation import Cancellation

P = ParamSpec("P")
Result = TypeVar("Result")


def _in_thread(job: Callable[P, Result]) -> Callable[P, Coroutine[Any, Any, Result]]:
    """Return a coroutine function that runs a job which takes ``on_progress`` and ``cancel``."""

    @wraps(job)
    async def run(*args: P.args, **kwargs: P.kwargs) -> Result:
        loop = asyncio.get_running_loop()
        cancel = kwargs.get("cancel") or Cancellation()
        assert isinstance(cancel, Cancellation)  # noqa: S101 - as its signature says
        kwargs["cancel"] = cancel
        if callable(report := kwargs.get("on_progress")):
            kwargs["on_progress"] = partial(loop.call_soon_threadsafe, report)
        running = loop.run_in_executor(None, partial(job, *args, **kwargs))
        try:
            return await asyncio.shield(running)
        except asyncio.CancelledError:
            cancel.cancel()
            await asyncio.wait([running])  # it leaves nothing behind, and then ends
            running.exception()
            raise

    return run


reconstruct_async = _in_thread(reconstruct)
reconstruct_async.__name__ = reconstruct_async.__qualname__ = "reconstruct_async"
reconstruct_async.__doc__ = """Turn points into a mesh beside an event loop: ``await`` it.

It takes what `reconstruct` takes, and runs in a thread of the loop's own. ``on_progress`` is called
by the loop. Whoever cancels the task cancels the job, whose workers are gone when the task ends.

Returns
-------
Mesh

Examples
--------
>>> import asyncio
>>> import hpcapp
>>> async def main() -> list[hpcapp.Mesh]:
...     scans = [hpcapp.simulate(name, points=3000) for name in ("torus", "sphere")]
...     return await asyncio.gather(*(hpcapp.reconstruct_async(scan, grid=32) for scan in scans))
>>> [mesh.is_watertight for mesh in asyncio.run(main())]
[True, True]
"""
