"""The verbs ``submit``, ``jobs``, ``logs``, ``attach``, ``cancel`` and ``fetch``."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.cli.named_files import InputFile, OutputFile, json_option
from hpccomponent.cli.terminal import align_rows, echo, echo_json
from hpccomponent.cli.verb import Verb
from hpccomponent.units import write_duration
from hpcdeploy.cli.arguments import FILE, JOB

if TYPE_CHECKING:
    from hpcdeploy.spec.job_folder import JobStatus


log = logging.getLogger("hpcapp")

VERB = "reconstruct"
DASHBOARD = click.option(
    "--dashboard", is_flag=True, help="Lead to the job's page from this machine; print its address."
)
AS_JSON = json_option("Print JSON objects on standard output, one a line.")


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp submit lab.yaml scan.laz -o mesh.ply",
            "Send the points, wait for the job, and fetch the mesh.",
        ),
        (
            "hpcapp submit lab.yaml scan.laz -o mesh.ply --detach",
            "Leave once the job is in the queue.",
        ),
        (
            "hpcapp submit lab.yaml scan.laz -o mesh.ply -- --grid 512 --close no",
            "Pass options on to 'reconstruct'.",
        ),
    ],
)
@FILE
@click.argument("points", type=InputFile(), help="A point cloud of any format that is read.")
@click.argument(
    "options",
    nargs=-1,
    type=click.UNPROCESSED,
    metavar="[-- OPTIONS]",
    help="Options of 'hpcapp reconstruct'.",
)
@click.option(
    "-o", "--output", required=True, type=OutputFile(), metavar="MESH", help="Mesh to write."
)
@click.option("--detach", is_flag=True, help="Leave once the job is in the queue.")
@DASHBOARD
@AS_JSON
def submit(
    file: Path,
    points: Path,
    options: tuple[str, ...],
    output: Path,
    detach: bool,
    dashboard: bool,
    as_json: bool,
) -> None:
    """Run 'reconstruct' on a cluster, as a job in its queue.

    The job goes on whatever becomes of this machine.
    """
    from hpcdeploy.jobs import cluster_job
    from hpcdeploy.jobs.queries import open_jobs
    from hpcdeploy.reconcile.cluster import open_cluster

    typed = ["submit", str(file), str(points), "-o", str(output)]
    typed += [*(["--dashboard"] if dashboard else []), *(["--", *options] if options else [])]
    if dashboard:
        options = (*options, "--dashboard")
    with open_cluster(file) as cluster:
        told = cluster_job.check_job(cluster, VERB, points, output, options)
        opened = open_jobs(cluster)
        request = cluster_job.make_request(cluster, typed)
        status = cluster_job.submit(opened, VERB, points, output.name, told, request)
        if detach:
            if as_json:
                _tell_json([status])
            log.info("hpcapp attach %s %s%s shows it, hpcapp fetch %s %s brings the mesh",
                     file, status.job, " --dashboard" if dashboard else "",
                     file, status.job)  # fmt: skip
            return
        status = cluster_job.watch(cluster, opened, status, has_page=dashboard)
        _tell_report(status, output, cluster_job.fetch(opened, status, output), as_json)


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp jobs lab.yaml", "List all jobs, and how they stand."),
        ("hpcapp jobs lab.yaml --json", "The same for a program, a line each."),
        ("hpcapp -q jobs lab.yaml", "List them without any news."),
    ],
)
@FILE
@AS_JSON
def jobs(file: Path, as_json: bool) -> None:
    """List the jobs of a cluster.

    The exit code is 4 where one of them cannot be read.
    COST is what the cluster costs at most in the time that a job ran, where it has a price.
    """
    from hpcdeploy.jobs.queries import open_jobs, raise_damage
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        listed = open_jobs(cluster).all()
    if as_json:
        _tell_json(listed)
    else:
        echo(_write_table(listed))
    raise_damage(listed)


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp logs lab.yaml", "Print the log of the last job."),
        ("hpcapp logs lab.yaml 3", "Print that of job 3."),
        ("hpcapp logs lab.yaml -f", "Go on until the last job has ended."),
    ],
)
@FILE
@JOB
@click.option("-f", "--follow", is_flag=True, help="Go on until the job has ended.")
def logs(file: Path, job: str | None, follow: bool) -> None:
    """Print what a job has said."""
    from hpcdeploy.jobs.display import JobDisplay
    from hpcdeploy.jobs.queries import open_jobs
    from hpcdeploy.reconcile.cluster import open_cluster

    class Printed(JobDisplay):
        def show_log(self, line: str) -> None:
            echo(line)

    with open_cluster(file) as cluster:
        opened = open_jobs(cluster)
        number = opened.find(job).job
        if follow:
            opened.follow(number, Printed())
            return
        for line in opened.log(number):
            echo(line)


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp attach lab.yaml", "Show the last job, with bars."),
        ("hpcapp attach lab.yaml 3", "Show job 3."),
        ("hpcapp attach lab.yaml 3 --dashboard", "Lead to its page, too."),
    ],
)
@FILE
@JOB
@DASHBOARD
def attach(file: Path, job: str | None, dashboard: bool) -> None:
    """Show a job until it has ended.

    Leaves with its exit code.
    """
    from hpcdeploy.jobs import cluster_job
    from hpcdeploy.jobs.queries import open_jobs, raise_failure
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        opened = open_jobs(cluster)
        status = cluster_job.watch(cluster, opened, opened.find(job), has_page=dashboard)
        raise_failure(status)
        log.info("job %s is done: hpcapp fetch %s %s brings the mesh", status.job, file, status.job)
        log.info("%s: %s", status.mesh, opened.report(status)["summary"])


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp cancel lab.yaml", "End the last job."),
        ("hpcapp cancel lab.yaml 3", "End job 3, or take it from the queue."),
        ("hpcapp cancel lab.yaml 3 -q", "End it without a word."),
    ],
)
@FILE
@JOB
def cancel(file: Path, job: str | None) -> None:
    """End a job."""
    from hpcdeploy.jobs.queries import open_jobs, raise_damage
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        opened = open_jobs(cluster)
        status = opened.cancel(opened.find(job).job)
        raise_damage([status])
        log.info("job %s is %s", status.job, status.state)


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp fetch lab.yaml", "Fetch the mesh of the last job, as it was called."),
        ("hpcapp fetch lab.yaml 3 -o mesh.ply", "Fetch that of job 3 as mesh.ply."),
        ("hpcapp fetch lab.yaml 3 --json", "Print the job's report, too."),
    ],
)
@FILE
@JOB
@click.option("-o", "--output", type=OutputFile(), metavar="MESH",
              help="Mesh to write; by default a new file in this folder, called as it was "
              "submitted.")  # fmt: skip
@AS_JSON
def fetch(file: Path, job: str | None, output: Path | None, as_json: bool) -> None:
    """Fetch the mesh of a job."""
    from hpcdeploy.jobs import cluster_job
    from hpcdeploy.jobs.queries import open_jobs, raise_failure
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        opened = open_jobs(cluster)
        status = opened.find(job)
        raise_failure(status)
        target = output or cluster_job.new_mesh_here(status)
        _tell_report(status, target, cluster_job.fetch(opened, status, target), as_json)


def _tell_report(status: JobStatus, mesh: Path, report: dict[str, object], as_json: bool) -> None:
    if as_json:
        command = status.request.command(str(Path.cwd()))
        echo_json(report | ({"command": command} if command else {}))  # the head has typed its own
    else:
        log.info("%s: %s", mesh, report["summary"])


def _tell_json(statuses: Sequence[JobStatus]) -> None:
    """Print jobs, one JSON object a line."""
    from hpcdeploy.spec.polling import utc_now

    here, now = str(Path.cwd()), utc_now()
    for status in statuses:
        told = asdict(status)
        del told["request"]
        times = {"seconds": status.seconds(now), "cost": status.cost(now)}
        echo_json(told | times | {"command": status.request.command(here)})


def _write_table(statuses: Sequence[JobStatus]) -> str:
    """Write jobs for people; of one that is damaged nothing but its state is known."""
    from hpcdeploy.reconcile.cost import write_dollars
    from hpcdeploy.spec.polling import utc_now

    now = utc_now()
    rows = [("JOB", "STATE", "SUBMITTED (UTC)", "TIME", "COST", "POINTS -> MESH")]
    for status in statuses:
        seconds, cost = status.seconds(now), status.cost(now)
        files = f"{status.title} -> {status.mesh}" if status.submitted else ""
        rows.append(
            (
                status.job,
                status.state,
                status.submitted[:16].replace("T", " ") or "-",
                "-" if seconds is None else write_duration(seconds),
                "-" if cost is None else write_dollars(cost),
                f"{files}  {status.reason}".strip(),
            )
        )
    return "\n".join(align_rows(rows)) if statuses else "no jobs"
