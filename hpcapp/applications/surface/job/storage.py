"""Where a job has its points and tiles besides memory, and what becomes of them.

::

    --temp-dir FOLDER ──> FOLDER/JOB-RUN/          held by this process (see `held_folders`)
                          ├── <hash>               a finished tile each
                          ├── sums/                of one run
                          └── points/              the cloud, where it is not in memory

    --update FOLDER ────> FOLDER/                  held while a job is at work
                          ├── frames/              what all tiles have in common
                          ├── tiles/               <hash>, sums/: as above, but for the next job
                          └── points/              while a job is at work

JOB is a hash of all that decides the mesh, RUN is random: two jobs of one input have a folder each.
A job that resumes takes one that nobody holds any more, and waits where all are held. In a bucket
nothing tells who lives: there it takes what is there.
"""

from __future__ import annotations

import logging
import os
import secrets
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from hpcapp.applications.surface.cloud.frame import Frame
from hpcapp.applications.surface.job.plan import Place, works_here
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.tiles.checkpoint import FRAMES, SUMS, Checkpoint, digest
from hpcapp.kernels.build import kernel_id
from hpccomponent.cli.terminal import visible_text
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import DistrustError, HpcError, InputError, OutputError, UsageError
from hpccomponent.files.held_folders import (
    HeldFolder,
    create_held,
    hold,
    read_owner,
    remove_abandoned,
    temporary_folder,
)
from hpccomponent.files.private_files import remove_path
from hpccomponent.posix import user_number
from hpccomponent.store.places import open_store

log = logging.getLogger("hpcapp")

_TILES = "tiles"
_OF_TILES = {_TILES, FRAMES, "points", ".owner"}  # all that a folder of --update holds


@dataclass(frozen=True, slots=True, eq=False)
class JobStorage:
    """Where a job has its points and tiles besides memory.

    The `checkpoint` keeps finished tiles; points lie in a `folder`, None where they are in memory.
    The `frame` is that of tiles that outlast the job.
    """

    checkpoint: Checkpoint | None
    folder: Path | None
    frame: Frame | None = None

    def note_frame(self) -> None:
        """Keep the frame for later jobs, if it is a new one and they are to have it."""
        if self.frame is None or self.frame.is_known:
            return
        assert self.checkpoint is not None  # noqa: S101 - where the frame was looked for
        self.checkpoint.begin_frame(self.frame.tell())


@contextmanager
def open_storage(settings: JobSettings, planned: Place) -> Iterator[JobStorage]:
    """Make room for what a job does not hold in memory, its points where it is planned.

    What lies there is taken away when the block ends, however it ends; but a job that resumes and
    fails leaves what it has finished. Raise UsageError, OutputError or CloudError if the place
    cannot be had, InputError if the input cannot be looked at.
    """
    in_memory = planned is Place.MEMORY
    if settings.method.needs_whole_cloud or (in_memory and settings.room is None):
        yield JobStorage(None, None)
        return
    if settings.update is not None:
        with _open_tiles(settings, settings.update) as (checkpoint, folder):
            known = checkpoint.find_frame("cloud")
            points = None if in_memory else folder / "points"
            yield JobStorage(checkpoint, points, Frame(known, keeps=True))
        return
    job, place = _name_job(settings), settings.temp_dir
    if place is None or "://" in place:
        with temporary_folder() as near:
            points = None if in_memory else near / job / "points"
            if place is None:
                checkpoint = Checkpoint(str(near), job, is_shared=works_here(settings))
                checkpoint.make_folders()
                yield JobStorage(checkpoint, points)
                return
            prefix = _choose_prefix(place, job, settings.resume)
            checkpoint = Checkpoint(place, prefix, settings.resume)
            checkpoint.check()
            with _taken_away(checkpoint):
                yield JobStorage(checkpoint, points)
        return
    held = _hold_folder(_find_folder(place, "--temp-dir"), job, settings.resume)
    checkpoint = Checkpoint(str(held.path.parent), held.path.name, settings.resume)
    with _taken_away(checkpoint, held):
        checkpoint.make_folders()
        yield JobStorage(checkpoint, None if in_memory else held.path / "points")


@contextmanager
def _open_tiles(settings: JobSettings, place: str) -> Iterator[tuple[Checkpoint, Path]]:
    """Open the tiles that jobs of unlike input share, and a folder for this one's points.

    When the block ends well only the tiles stay that this job has asked for; if not, all.
    """
    recipe = digest(*_list_recipe(settings))
    with ExitStack() as stack:
        if "://" in place:
            folder = stack.enter_context(temporary_folder())
            checkpoint = Checkpoint(place, _TILES, True, recipe=recipe)
            checkpoint.check()
        else:
            folder = _find_folder(place, "--update")
            held = _hold_tiles(folder)
            stack.callback(held.let_go)
            stack.callback(remove_path, folder / "points")
            checkpoint = Checkpoint(str(folder), _TILES, True, recipe=recipe)
            checkpoint.make_folders()
        try:
            yield checkpoint, folder
        except DistrustError:  # nothing of it is to be believed
            checkpoint.clear()
            raise
        checkpoint.clear_others()


def _hold_tiles(folder: Path) -> HeldFolder:
    """Hold the folder of --update, which may be a new one; wait for whoever has it."""
    if not os.path.lexists(folder):
        return create_held(folder)
    try:
        others = sorted(set(os.listdir(folder)) - _OF_TILES)
    except OSError as error:
        raise OutputError(
            f"--update {folder}: cannot be looked into: {error.strerror}", "name another folder"
        ) from error
    if others:
        raise UsageError(
            f"--update {folder}: holds other things than the tiles of a job, as {others[0]}",
            "name a folder that --update has filled, or a new one",
        )
    held = hold(folder)
    if held is None and (owner := read_owner(folder)) is not None:
        log.info("waiting for %s, which has its tiles in %s", owner, folder)
        held = hold(folder, waits=True)
    if held is None:
        raise OutputError(f"--update {folder}: cannot be held", "name a folder of your own")
    remove_path(folder / _TILES / SUMS)
    return held


def _find_folder(place: str, option: str) -> Path:
    """Return the folder that an option names; its last part need not be there."""
    text = place.removeprefix("folder:")
    if not text:
        raise UsageError(f"{option} names no folder", "name one, or s3://BUCKET/PREFIX")
    if text.startswith("~"):  # a shell has left it so: of --temp-dir=~/x, or no such user
        raise UsageError(
            f"{option} {text}: no such home folder is known here",
            f"write the whole path, or ./{text} for a folder of that name",
        )
    folder = Path(os.path.realpath(text))  # a link may lead to itself
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{option} {text}: is not a folder", "name a folder")
    if visible_text(str(folder)) != str(folder):
        raise OutputError(
            f"{option} {text}: its path is not UTF-8, or holds control characters: workers are "
            "not told of it",
            "name another folder",
        )
    return folder


def _name_job(settings: JobSettings) -> str:
    """Return a hash of the input, of what decides the mesh, and of the kernels."""
    size = settings.points.stat().st_size
    return digest(*map(_identify, settings.files), size, *_list_recipe(settings))


def _list_recipe(settings: JobSettings) -> tuple[Any, ...]:
    """Return all that decides the mesh of some input: settings and kernels."""
    return (
        settings.grid, settings.depth, settings.voxel_size, repr(settings.method),
        settings.outliers, settings.denoise, settings.resample, settings.normals,
        settings.viewpoint, settings.attributes.has_confidence, repr(settings.crop), kernel_id(),
    )  # fmt: skip


def _identify(file: Path) -> str:
    """Return what tells a file from another one, and from itself when it was changed."""
    try:
        found = file.stat()
    except OSError as error:
        raise InputError(
            f"{file}: cannot be read: {error.strerror}", "check the file's name"
        ) from error
    return f"{visible_text(str(file.resolve()))} {found.st_size} {found.st_mtime_ns}"


@contextmanager
def _taken_away(checkpoint: Checkpoint, held: HeldFolder | None = None) -> Iterator[None]:
    """Take away what a job has kept, when it is done or has failed; see `open_storage`."""
    is_left = False
    try:
        yield
    except DistrustError:  # nothing of it is to be believed
        raise
    except BaseException:
        is_left = _leave_work(checkpoint)
        raise
    finally:
        if held is None:
            if not is_left:
                _clear_bucket(checkpoint)
        elif is_left:
            held.let_go()
        else:
            held.remove()


def _leave_work(checkpoint: Checkpoint) -> bool:
    """Tell whether what a failed job has finished is left, and say what becomes of it."""
    try:
        is_something = checkpoint.holds_work()
    except HpcError:  # the bucket is out of reach
        is_something = checkpoint.resumes
    if is_something and checkpoint.resumes:
        log.warning(
            "what is finished is kept in %s: the same command with --resume goes on from there",
            checkpoint.where,
        )
    elif is_something:
        log.warning("what was finished is removed: a job that is started with --resume keeps it")
    return is_something and checkpoint.resumes


def _clear_bucket(checkpoint: Checkpoint) -> None:
    try:
        checkpoint.clear()
    except HpcError as error:
        log.warning("warning: some of %s is left: %s", checkpoint.where, error)


def _hold_folder(folder: Path, job: str, resumes: bool) -> HeldFolder:
    """Hold a folder in which this process does a job."""
    if resumes:
        if (found := _hold_left(folder, job)) is not None:
            return found
    else:
        for owner in remove_abandoned(folder, f"{job}-"):
            log.info("%s has the same job in %s: this one has a folder of its own", owner, folder)
    return create_held(folder / _name_run(job))


def _hold_left(folder: Path, job: str) -> HeldFolder | None:
    """Hold what an earlier run of a job has left; None where there is nothing, or no use in it."""
    while True:
        busy = None
        for path in sorted(folder.glob(f"{job}-*")):
            held = hold(path)
            if held is None:
                busy = _name_busy(path) or busy
            elif Checkpoint(str(folder), path.name).holds_work():
                remove_path(path / SUMS)  # they are of one run
                return held
            else:
                held.remove()
        if busy is None:
            return None
        log.info("waiting for %s, which has the same job in %s", read_owner(busy), folder)
        held = hold(busy, waits=True)
        if held is not None:
            held.let_go()
        elif busy.exists():  # it cannot be waited for
            return None


def _name_busy(path: Path) -> Path | None:
    """Return a folder that somebody holds; None where nobody says so, as of another user's."""
    if read_owner(path) is not None:
        return path
    with suppress(OSError):
        if os.lstat(path).st_uid == user_number() and not os.access(path, os.R_OK | os.X_OK):
            log.warning("warning: %s cannot be looked into: what it keeps is not used", path)
    return None


def _choose_prefix(place: str, job: str, resumes: bool) -> str:
    """Return under which prefix of a bucket a job keeps its tiles: that with most, or a new one."""
    names = open_store(place).list(f"{job}-") if resumes else []
    found = Counter(name.partition("/")[0] for name in names)
    return max(sorted(found), key=found.__getitem__) if found else _name_run(job)


def _name_run(job: str) -> str:
    return f"{job}-{secrets.token_hex(4)}"
