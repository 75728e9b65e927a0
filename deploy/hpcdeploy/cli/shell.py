"""The verbs ``ssh``, ``exec``, ``put`` and ``get``: commands and files on a cluster's machines."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from hpccomponent.cli.named_files import InputFile, OutputFile
from hpccomponent.cli.terminal import echo, echo_output
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import CloudError, HpcError, UsageError
from hpccomponent.files.outputs import Written
from hpccomponent.files.paths import check_regular
from hpcdeploy.cli.arguments import FILE
from hpcdeploy.cli.asking import say

if TYPE_CHECKING:
    from hpcdeploy.login.access import Access
    from hpcdeploy.login.shell import Shell
    from hpcdeploy.provider import MachineSeen
    from hpcdeploy.reconcile.cluster import Cluster


WAIT_S = 30.0  # these machines have answered before
AT_ONCE = 16


def _find_target(target: Path, source: str) -> Path:
    """Return where a file is put that a machine sends."""
    return target / source.rstrip("/").rpartition("/")[2] if target.is_dir() else target


def _list_fetched(name: str, option: str, params: Mapping[str, Any]) -> Iterator[Written]:
    yield Written(_find_target(Path(name), params["source"]), option)


@click.command(
    cls=Verb,
    context_settings={"allow_interspersed_args": False},
    examples=[
        ("hpcapp ssh lab.yaml", "Open a terminal on the head."),
        ("hpcapp ssh lab.yaml worker-1", "Open one on a worker."),
        ("hpcapp ssh lab.yaml head top", "Run a program that needs a terminal."),
    ],
)
@FILE
@click.argument("node", default="head", help="Where: head (without one), worker-1, ...")
@click.argument(
    "command", nargs=-1, type=click.UNPROCESSED, help="What to run; a login shell without."
)
def ssh(file: Path, node: str, command: tuple[str, ...]) -> None:
    """Open a terminal on a machine, or run a command in one."""
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster, _open_one(cluster, node) as shell:
        code = shell.interact(" ".join(command))
    raise click.exceptions.Exit(code)


@click.command(
    "exec",
    cls=Verb,
    context_settings={"ignore_unknown_options": True},
    examples=[
        ("hpcapp exec lab.yaml uptime", "Run a command on the head."),
        ("hpcapp exec lab.yaml --all df /", "Run it on every machine at once."),
        (
            "hpcapp exec lab.yaml --node worker-1 -- ls --all",
            "Put -- before a command with options of these names.",
        ),
    ],
)
@FILE
@click.option("--node", "nodes", multiple=True, metavar="NAME", help="Where; more than once.")
@click.option("--all", "is_all", is_flag=True, help="On every machine.")
@click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED, help="What to run.")
def exec_(file: Path, nodes: tuple[str, ...], is_all: bool, command: tuple[str, ...]) -> None:
    """Run a command on the head, on some machines, or on all.

    Every line of output has its node's name before it; leaves with the largest exit code, 4 where
    a machine cannot be reached. Where the command has options of the names below, put -- before it.
    Escape codes are written out on a terminal, and kept for a file or a pipe.
    """
    from concurrent.futures import ThreadPoolExecutor

    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        machines, silent = _choose(cluster, nodes, is_all=is_all)
        pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="exec")
        try:
            runs = [pool.submit(_run, cluster.access, m, " ".join(command)) for m in machines]
            codes = [run.result() for run in runs]
        except BaseException:
            cluster.access.close()  # an interrupt must not wait for the machines
            raise
        finally:
            pool.shutdown(cancel_futures=True)
    _tell(silent, codes)


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp put lab.yaml scan.laz", "Send a file to the head's home."),
        ("hpcapp put lab.yaml scan.laz scans/", "Send it into a folder there."),
        ("hpcapp put lab.yaml settings.txt --all", "Send it to every machine."),
    ],
)
@FILE
@click.argument("source", type=InputFile(exists=True), help="A file here.")
@click.argument(
    "target",
    default="",
    help="Where it goes, from the login user's home on; a folder ends in /. Its own name without.",
)
@click.option("--node", "nodes", multiple=True, metavar="NAME", help="Where; more than once.")
@click.option("--all", "is_all", is_flag=True, help="To every machine.")
def put(file: Path, source: Path, target: str, nodes: tuple[str, ...], is_all: bool) -> None:
    """Send a file to machines of a cluster.

    What was interrupted goes on. Machines that cannot be reached are named, the others get it, and
    the exit code is 4.
    """
    from hpcdeploy.reconcile.cluster import open_cluster

    check_regular(source)
    if not target or target.endswith("/"):
        target += source.name
    with open_cluster(file) as cluster:
        machines, failures = _choose(cluster, nodes, is_all=is_all)
        for machine in machines:
            try:
                with cluster.access.open(machine, WAIT_S) as shell:
                    shell.put(source, target)
                    say(f"{shell.node}: {target}")
            except CloudError as error:  # the others are served nevertheless
                failures.append(error)
    _tell(failures, [0])


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp get lab.yaml mesh.ply", "Fetch a file from the head into this folder."),
        ("hpcapp get lab.yaml out/mesh.ply lab_mesh.ply", "Fetch it under another name."),
        ("hpcapp get lab.yaml loader.log --node worker-2", "Fetch one from a worker."),
    ],
)
@FILE
@click.argument("source", help="A file there, from the login user's home on.")
@click.argument(
    "target",
    default=".",
    type=OutputFile(lists=_list_fetched),
    help="A file or folder here; this folder without.",
)
@click.option("--node", default="head", metavar="NAME", help="From where.")
def get(file: Path, source: str, target: Path, node: str) -> None:
    """Fetch a file from a machine of a cluster.

    What was interrupted goes on.
    """
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster, _open_one(cluster, node) as shell:
        shell.get(source, _find_target(target, source))


def _choose(
    cluster: Cluster, nodes: Sequence[str], *, is_all: bool = False
) -> tuple[list[MachineSeen], list[CloudError]]:
    """Return the machines that are meant, the head where none is named; and why some are left out.

    Those that are there and do not run, or do not let us see whether they do, are left out.
    """
    from hpcdeploy.reconcile.cluster import describe_silent
    from hpcdeploy.spec.names import HEAD

    if is_all and nodes:
        raise UsageError("--all and --node contradict each other", "give one of them")
    present = cluster.present()
    running = {m.name.node: m for m in present if m.state == "running"}
    silent = {m.name.node: describe_silent(m) for m in present if m.name.node not in running}
    chosen = [*running, *silent] if is_all else [*nodes] or [HEAD]
    for node in chosen or [HEAD]:
        if node in running or node in silent:
            continue
        if running and node != HEAD:
            raise UsageError(f"no machine {node} runs", f"choose among {', '.join(running)}")
        raise CloudError(
            f"cluster {cluster.spec.cluster} is not up", f"run hpcapp up {cluster.path}"
        )
    return (
        [running[node] for node in chosen if node in running],
        [silent[node] for node in chosen if node in silent],
    )


def _open_one(cluster: Cluster, node: str) -> Shell:
    """Open a shell on the machine of a node, where it runs."""
    machines, silent = _choose(cluster, [node])
    for error in silent:
        raise error
    return cluster.access.open(machines[0], WAIT_S)


def _tell(errors: Sequence[HpcError], codes: Sequence[int]) -> NoReturn:
    """Say what could not be done, and leave with the largest exit code."""
    for error in errors:
        echo(str(error), err=True)
    raise click.exceptions.Exit(max([*codes, *(error.exit_code for error in errors)]))


_writing = threading.Lock()


def _run(access: Access, machine: MachineSeen, command: str) -> int:
    """Run the command on one machine; a machine that cannot be reached is an exit code too."""
    node = machine.name.node

    def show(line: str) -> None:
        with _writing:
            echo_output(f"{node}: {line}")

    try:
        with access.open(machine, WAIT_S) as shell:
            return shell.follow(command, show)
    except HpcError as error:
        echo(str(error), err=True)
        return error.exit_code
