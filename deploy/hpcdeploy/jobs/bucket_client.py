"""The head's side of a bucket: presigned addresses, no credentials; only the standard library."""

from __future__ import annotations

import os
import shutil
import ssl
import urllib.error
import urllib.request
from collections.abc import Callable
from http.client import HTTPException, HTTPResponse
from pathlib import Path

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import sha256_of
from hpcdeploy.spec.job_folder import JobOrder

CHUNK = 1 << 20
TIMEOUT_S = 60.0
ATTEMPTS = 3


def fetch_points(order: JobOrder, target: Path, say: Callable[[str], None]) -> None:
    """Fetch a job's points unless they are there; what is there in part goes on.

    The SHA-256 of its content names `target`. Raises CloudError where the bucket does not give
    them, or gives others.
    """
    if target.exists():
        return
    target.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = target.with_name(target.name + ".part")
    say("fetching the points from the bucket")
    for attempt in range(1, ATTEMPTS + 1):
        try:
            _download(order, part)
            break
        except (OSError, HTTPException) as error:
            if attempt == ATTEMPTS or isinstance(error, urllib.error.HTTPError):
                raise CloudError(
                    f"the points cannot be fetched from the bucket ({error})", "submit them again"
                ) from error
    if sha256_of(part) != target.stem:
        part.unlink()
        raise CloudError("the bucket holds other points than were sent", "submit them again")
    os.replace(part, target)


def _download(order: JobOrder, part: Path) -> None:
    have = part.stat().st_size if part.exists() else 0
    headers = {"Range": f"bytes={have}-"} if have else {}
    request = urllib.request.Request(order.points_url, headers=headers)  # noqa: S310 - the user's
    try:
        with (
            _open(order, request) as answer,
            part.open("ab" if answer.status == 206 else "wb") as f,
        ):
            shutil.copyfileobj(answer, f, CHUNK)
    except urllib.error.HTTPError as error:
        if error.code != 416:  # all of it is there
            raise
        error.close()


def send_mesh(order: JobOrder, mesh: Path, say: Callable[[str], None]) -> str:
    """Send a job's mesh; return its SHA-256, or nothing where the bucket does not take it.

    The mesh stays on the head as well, so that it can still be fetched from there.
    """
    say("sending the mesh to the bucket")
    reason = ""
    for _ in range(ATTEMPTS):
        try:
            with mesh.open("rb") as stream:
                request = urllib.request.Request(  # noqa: S310 - the user's own address
                    order.mesh_url,
                    data=stream,
                    method="PUT",
                    headers={
                        "Content-Length": str(mesh.stat().st_size),
                        "Content-Type": "application/octet-stream",  # or it would be a form
                    },
                )
                with _open(order, request):
                    return sha256_of(mesh)
        except (OSError, HTTPException) as error:
            reason = str(error)
            if isinstance(error, urllib.error.HTTPError):
                error.close()
                break
    say(f"the bucket does not take the mesh ({reason}); it stays on the head")
    return ""


def _open(order: JobOrder, request: urllib.request.Request) -> HTTPResponse:
    context = ssl.create_default_context(cadata=order.ca_bundle or None)
    answer: HTTPResponse = urllib.request.urlopen(  # noqa: S310 - the user's own address
        request, timeout=TIMEOUT_S, context=context
    )
    return answer
