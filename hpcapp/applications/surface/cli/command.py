"""The verb of surface reconstruction: ``reconstruct``.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click

from hpcapp.applications.points.command import readable
from hpcapp.applications.surface.attributes.choice import parse_attributes
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.methods.options import (
    WATCHED,
    Options,
    check_exclusive,
    group_options,
    make_click_options,
    option_names,
    parse_typed,
    typed_command,
)
from hpcapp.applications.surface.methods.table import DEFAULT_METHOD, METHODS, find_method
from hpcapp.dashboard import DEFAULT_ADDRESS
from hpcapp.mending.options import PIECES, SMALLEST
from hpcapp.parts.crop import CROPPED, Crop, parse_crop
from hpcapp.parts.options import AROUND, BOX, CLASSES, GROUND, INPUTS, NOT_CLASSES, POLYGON, SAMPLE
from hpcapp.printing.request import PrintOptions, take_printing
from hpcapp.progress import Progress
from hpcapp.simplification.command import ORIGIN, UP
from hpcapp.texture.request import check_images, check_library, check_texture
from hpcapp.timeline import Timeline
from hpccomponent.cli.named_files import STREAM, json_option
from hpccomponent.cli.terminal import align_rows, echo, echo_json
from hpccomponent.cli.verb import Verb
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

log = logging.getLogger("hpcapp")


def _check_method_options(ctx: click.Context) -> None:
    """Raise UsageError where an option was typed that means nothing to the method."""
    method = ctx.params["method"]
    for name, owner in METHOD_OPTIONS.items():
        if owner != method and _is_typed(ctx, name):
            raise UsageError(
                f"{_flag(name)} means nothing to --method {method}",
                f"leave it out, or choose --method {owner}",
            )
    check_exclusive(find_method(method), {name for name in METHOD_OPTIONS if _is_typed(ctx, name)})
    if find_method(method).needs_whole_cloud:
        for name in ("max_memory", "temp_dir", "resume", "update"):
            if _is_typed(ctx, name):
                raise UsageError(
                    f"{_flag(name)} means nothing to --method {method}, which needs all points in "
                    "memory",
                    f"leave it out, or choose --method {DEFAULT_METHOD}",
                )


def _is_typed(ctx: click.Context, name: str) -> bool:
    return ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _check_texture(ctx: click.Context) -> None:
    """Raise UsageError where no texture can come of what was asked for."""
    output = ctx.params["output"]
    check_texture(output, ctx.params["faces"], ctx.params["size"])
    if ctx.params["cluster"] is not None and Path(output).suffix.lower() != ".glb":
        raise UsageError(
            f"{output} with --texture is several files, and one comes from a cluster",
            "write a .glb",
        )
    parse_attributes(ctx.params["attributes"]).for_texture()


def _check_images(ctx: click.Context) -> None:
    """Raise UsageError where no texture takes photographs, or not from here."""
    check_images(ctx.params["images"], ctx.params["texture"])
    cluster = ctx.params["cluster"]
    if cluster is not None and cluster.suffix != ".json":
        raise UsageError(
            "--images and --cluster exclude each other: photographs are read on this machine",
            "run it on the cluster's head, or here",
        )


def _only_without_cluster(ctx: click.Context) -> None:
    """Raise UsageError where workers were asked for beside those of the cluster."""
    if ctx.get_parameter_source("workers") is click.core.ParameterSource.COMMANDLINE:
        raise UsageError(
            "--cluster and --workers exclude each other",
            "the workers of a cluster are those of its file",
        )
    backend = ctx.params["backend"]
    if backend not in ("auto", "zmq"):
        raise UsageError(
            f"--cluster and --backend {backend} exclude each other",
            "--backend zmq uses the cluster's workers, auto where they pay",
        )


METHOD_OPTIONS = {name: method for method in METHODS for name in option_names(find_method(method))}
"""The method of each of the methods' own options."""


def check_flags(ctx: click.Context) -> None:
    """Raise UsageError where flags contradict each other, or have values that cannot be used."""
    check_exclusive(JobSettings, {name for name, value in ctx.params.items() if value is not None})
    if ctx.params["details"] and not ctx.params["as_json"] and ctx.params["cluster"] is None:
        raise UsageError("--details means nothing without --json", "give --json too")
    if ctx.params["texture"] is not None:
        _check_texture(ctx)
    if ctx.params["images"] is not None:
        _check_images(ctx)
    if ctx.params["cluster"] is not None:
        _only_without_cluster(ctx)
    if ctx.params["backend"] != "auto":
        from hpcapp.backends.selection import check_backend

        check_backend(ctx.params["backend"])
    if ctx.params["dashboard"] is not None:
        from hpcapp.dashboard.server import parse_address

        parse_address(ctx.params["dashboard"])
    parse_typed(JobSettings, ctx.params)
    take_printing(dict(ctx.params))
    if ctx.params["origin"] not in ("auto", "keep"):
        from hpcapp.io.placement import parse_origin

        parse_origin(ctx.params["origin"])
    parse_crop(*(ctx.params[name] for name in CROPPED))
    if ctx.params["size"] is not None:
        from hpcapp.simplification.size import read_size

        read_size(ctx.params["size"], ctx.params["output"])
    _check_method_options(ctx)


_BESIDE = {
    "Points": (*CROPPED, "sample"),
    "Surface": ("pieces", "smallest", "origin", "up", "method"),
    "Watching and reporting": ("plan", "as_json", *WATCHED),
}
"""What other verbs have too, or no job keeps, below the headings of help."""


def _group_options() -> dict[str, list[str]]:
    """Return the names of all options below their headings."""
    groups: dict[str, list[str]] = {}
    methods = ((find_method(name), f"With --method {name}") for name in METHODS)
    for settings, other in ((JobSettings, ""), (PrintOptions, ""), *methods):
        for title, name in group_options(settings, other):
            groups.setdefault(title, []).append(name)
    for title, names in _BESIDE.items():
        groups[title] += names
    return groups


def _add_options(command: click.Command) -> click.Command:
    """Give a command the options of a job, before its own, and those of all methods, each once."""
    kinds: tuple[type[Options], ...] = (JobSettings, PrintOptions, *map(find_method, METHODS))
    made = [option for settings in kinds for option in make_click_options(settings)]
    points, *others = command.params
    command.params = [points, *made, *others]
    return command


@_add_options
@click.command(
    cls=Verb,
    groups=_group_options(),
    examples=[
        ("hpcapp reconstruct scan.laz -o mesh.ply", "Mesh a scan as finely as it resolves."),
        (
            "hpcapp reconstruct '*.e57' -o house.glb --faces 500000 --report house.html",
            "Mesh many scans as one, with 500,000 triangles, and say on a page what was decided.",
        ),
        (
            "hpcapp reconstruct survey.laz -o survey.tiles --cluster lab.yaml",
            "Mesh a survey on the machines of a cluster file, into a folder of tiles.",
        ),
    ],
)
@INPUTS
@SAMPLE
@BOX
@AROUND
@POLYGON
@CLASSES
@NOT_CLASSES
@GROUND
@click.option(
    "--method",
    type=click.Choice(list(METHODS)),
    default=DEFAULT_METHOD,
    show_default=True,
    help=", or ".join(find_method(method).summary for method in METHODS) + ".",
)
@PIECES
@SMALLEST
@ORIGIN
@UP
@click.option(
    "--plan",
    is_flag=True,
    help="Only print what the job would do: where the points lie, who works, and about how much "
    "memory and disk it takes.",
)
@click.option(
    "--events",
    type=STREAM,
    metavar="FILE",
    help="Write the progress to a file as it comes, one JSON object a line.",
)
@click.option(
    "--trace",
    type=STREAM,
    metavar="FILE",
    help="Write when each stage and each task ran, and on which worker, as a Chrome trace.",
)
@click.option(
    "--dashboard",
    is_flag=False,
    flag_value=DEFAULT_ADDRESS,
    metavar="[HOST:PORT]",
    help="Show the job on a page while it runs; its address is printed. On loopback unless a host "
    "is given.",
)
@json_option()
@click.pass_context
def reconstruct(ctx: click.Context, /, **options: Any) -> None:
    """Reconstruct a mesh from the point clouds POINTS.

    It is watertight where the points are of an object, and open where they are of a view, a
    terrain or a room. All of a scan's colours and values are on its vertices.
    """
    check_flags(ctx)
    as_json = options.pop("as_json")
    if options.pop("plan"):
        _print_plan(options, as_json)
        return
    watching = Watching(*(options.pop(name) for name in WATCHED))
    cluster = options["cluster"]
    if cluster is not None and cluster.suffix != ".json":
        from hpcapp.applications.surface.cli.remote import run_on_cluster

        report = run_on_cluster(ctx)
    else:
        options["command"] = typed_command(ctx)
        report = _run_here(options, watching)
    if as_json:
        echo_json(report)
    else:
        for name, value in report.items():  # with -v
            log.debug("%s: %s", name.replace("_", " "), readable(value))
        log.info("%s: %s", options["output"], report["summary"])


@dataclass(frozen=True, slots=True)
class Watching:
    """How the user wants to watch a job, beside the bars.

    The files of events and trace are written; the dashboard is served at ``HOST:PORT``.
    """

    events: Path | None
    trace: Path | None
    dashboard: str | None

    @contextmanager
    def open(
        self, title: str, timeline: Timeline
    ) -> Iterator[tuple[Progress, Callable[[str], None]]]:
        """Open all of it, for one job, which fills the timeline.

        Yields where the job's stages are announced, and what shows a line to who watches on a page.
        """
        from hpcapp.progress_display import open_events, open_progress
        from hpcapp.trace import open_trace

        with open_trace(self.trace, timeline):
            if not self.dashboard:
                with open_progress(sys.stderr) as display, open_events(self.events, None) as events:
                    yield Progress(events, display), lambda _: None
                return
            from hpcapp.dashboard.server import open_dashboard
            from hpcapp.dashboard.watched_job import WatchedJob

            job = WatchedJob(timeline, title)
            with (
                open_dashboard(self.dashboard, job) as address,
                open_progress(sys.stderr) as display,
                open_events(self.events, address) as events,
            ):
                if self.events is None:  # else whoever reads them shows it
                    log.info("dashboard: %s", address)
                with job.running():
                    yield Progress(job, events, display), job.say


def _read_options(options: dict[str, Any], names: Sequence[str]) -> partial[JobSettings]:
    """Return the settings that were typed, but for the file of the points."""
    from hpcapp.io.placement import parse_origin
    from hpcapp.io.points.inputs import find_paths
    from hpcapp.simplification.size import read_size

    viewpoints = options["viewpoint"]
    options = parse_typed(JobSettings, options)
    if options["images"] is not None:
        from hpcapp.texture.photos.folder import find_photos

        options["images"] = find_photos(options["images"], viewpoints)
    if options["texture"] is not None:
        check_library()
        options["attributes"] = options["attributes"].for_texture()
    options["printing"] = take_printing(options)
    options["origin"] = parse_origin(options["origin"])
    crop = parse_crop(*(options.pop(name) for name in CROPPED))
    if options["size"] is not None:
        options["size"] = read_size(options["size"], options["output"])
    own = {name: options.pop(name) for name in METHOD_OPTIONS}
    method = find_method(options.pop("method"))
    chosen = {name: own[name] for name in option_names(method)}
    files = find_paths(names)
    if options["resume"] and not files:
        raise UsageError("--resume needs a file to know again", "write the points to a file")
    return partial(JobSettings, method=method(**chosen), inputs=files, crop=crop, **options)


def _print_plan(options: dict[str, Any], as_json: bool) -> None:
    """Print what a job would do here."""
    from hpcapp.applications.surface.job.plan import plan_job
    from hpcapp.applications.surface.resolution.memory import count_most_points
    from hpcapp.io import open_points
    from hpcapp.io.points.inputs import find_sample, is_packed

    if options["cluster"] is not None:
        raise UsageError(
            "--plan tells of this machine",
            "leave --cluster out; 'hpcapp plan' tells which machines a cluster file asks for",
        )
    for name in WATCHED:
        options.pop(name)
    names, sample = options.pop("points"), options.pop("sample")
    make = _read_options(options, names)
    files: tuple[Path, ...] = make.keywords["inputs"]
    if not files or any(map(is_packed, names)):
        raise UsageError("--plan needs files to look into", "unpack them, or write them to files")
    points = 0
    for file in files:
        open_points(file)  # what cannot be read is refused
        points += sample or find_sample(file) or count_most_points(file)
    plan = plan_job(make(points=files[0]).for_ground(), points)
    if as_json:
        echo_json(plan.to_json())
    else:
        for line in align_rows(plan.describe()):
            echo(line)


def _run_here(options: dict[str, Any], watching: Watching) -> dict[str, Any]:
    """Run the job with this process as its master."""
    from hpcapp.backends.selection import start_early

    name = options["backend"] if options["cluster"] is None else "cluster"
    if options["resume"]:  # it may wait for another job, and machines would give up meanwhile
        name = "auto"
    with start_early(name, options["workers"]) as machines:
        from hpcapp.alignment.place import choose_place
        from hpcapp.applications.surface.cli.run import run_job  # while the machines start
        from hpcapp.applications.surface.job.source import MARGIN
        from hpcapp.io.points.inputs import gather_points

        names, sample = options.pop("points"), options.pop("sample")
        make = _read_options(options, names)
        crop: Crop = make.keywords["crop"]
        timeline = Timeline()
        title = f"{Path(names[0]).name} \u2192 {options['output']}"
        with (
            gather_points(
                names,
                sample,
                for_surface=True,
                keeps_noise=crop.keeps_noise,
                choose=partial(crop.narrow, margin=MARGIN),
                place=choose_place(options["align"]),
            ) as points,
            watching.open(title, timeline) as (progress, say),
        ):
            report = run_job(make(points=points).for_ground(), progress, machines, timeline)
            say(f"{options['output']}: {report['summary']}")  # the terminal's comes last
            return report
