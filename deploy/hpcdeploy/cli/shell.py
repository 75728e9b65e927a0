"""The verbs ``ssh``, ``exec``, ``put`` and ``get``: commands and files on a cluster's machines."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from hpccomponent.errors import CloudError, HpcError, UsageError
from hpccomponent.files.paths import check_regular
from hpccomponent.terminal import echo, echo_output

if TYPE_CHECKING:
    from hpcdeploy.machine.access import Access
    from hpcdeploy.machine.provider import MachineSeen
    from hpcdeploy.reconcile.cluster import Cluster

__all__ = ["exec_", "get", "put", "ssh"]

FILE = click.Path(dir_okay=False, path_type=Path)
WAIT_S = 30.0  # these machines have answered before
AT_ONCE = 16


@click.command(context_settings={"allow_interspersed_args": False})
@click.argument("file", type=FILE)
@click.argument("node", default="head")
@click.argument("command", nargs=-1, type=click.UNPROCESSED)
def ssh(file: Path, node: str, command: tuple[str, ...]) -> None:
    """Open a terminal on a NODE of the cluster file FILE, or run a COMMAND in one."""
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        [machine] = _choose(cluster, [node], is_all=False)
        with cluster.access.open(machine, WAIT_S) as shell:
            code = shell.interact(" ".join(command))
    _leave(code)


@click.command("exec", context_settings={"ignore_unknown_options": True})
@click.argument("file", type=FILE)
@click.option("--node", "nodes", multiple=True, metavar="NAME", help="Where; more than once.")
@click.option("--all", "is_all", is_flag=True, help="On every machine.")
@click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED)
def exec_(file: Path, nodes: tuple[str, ...], is_all: bool, command: tuple[str, ...]) -> None:
    """Run a COMMAND on the head of the cluster file FILE, on some nodes, or on all at once.

    Every line of output has its node's name before it; leaves with the largest exit code. Where
    the command has options of the names above, put -- before it. Escape codes are written out on
    a terminal, and kept for a file or a pipe.
    """
    from concurrent.futures import ThreadPoolExecutor

    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        machines = _choose(cluster, nodes, is_all=is_all)
        pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="exec")
        try:
            runs = [pool.submit(_run, cluster.access, m, " ".join(command)) for m in machines]
            codes = [run.result() for run in runs]
        except BaseException:
            cluster.access.close()  # an interrupt must not wait for the machines
            raise
        finally:
            pool.shutdown(cancel_futures=True)
    _leave(max(codes))


@click.command()
@click.argument("file", type=FILE)
@click.argument("source", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("target", default="")
@click.option("--node", "nodes", multiple=True, metavar="NAME", help="Where; more than once.")
@click.option("--all", "is_all", is_flag=True, help="To every machine.")
def put(file: Path, source: Path, target: str, nodes: tuple[str, ...], is_all: bool) -> None:
    """Send the file SOURCE to the head of the cluster file FILE; an interrupted one goes on.

    TARGET is relative to the login user's home; by default it is the file's own name.
    """
    from hpcdeploy.reconcile.cluster import open_cluster

    check_regular(source)
    if not target or target.endswith("/"):
        target += source.name
    with open_cluster(file) as cluster:
        for machine in _choose(cluster, nodes, is_all=is_all):
            with cluster.access.open(machine, WAIT_S) as shell:
                shell.put(source, target)
                echo(f"{shell.node}: {target}", err=True)


@click.command()
@click.argument("file", type=FILE)
@click.argument("source")
@click.argument("target", default=".", type=click.Path(path_type=Path))
@click.option("--node", default="head", metavar="NAME", help="From where.")
def get(file: Path, source: str, target: Path, node: str) -> None:
    """Fetch the file SOURCE from the head of the cluster file FILE; an interrupted one goes on.

    SOURCE is relative to the login user's home.
    """
    from hpcdeploy.reconcile.cluster import open_cluster

    if target.is_dir():
        target /= source.rstrip("/").rpartition("/")[2]
    check_regular(target)
    with open_cluster(file) as cluster:
        [machine] = _choose(cluster, [node], is_all=False)
        with cluster.access.open(machine, WAIT_S) as shell:
            shell.get(source, target)


def _choose(cluster: Cluster, nodes: Sequence[str], *, is_all: bool) -> list[MachineSeen]:
    """Return the machines that are meant: the head where none is named."""
    if is_all and nodes:
        raise UsageError("--all and --node contradict each other", "give one of them")
    machines = list(cluster.machines())
    if not machines:
        raise CloudError(
            f"cluster {cluster.spec.cluster} is not up", f"run hpcapp up {cluster.path}"
        )
    if is_all:
        return machines
    by_name = {machine.name.node: machine for machine in machines}
    for node in nodes:
        if node not in by_name:
            raise UsageError(f"no machine {node} runs", f"choose among {', '.join(by_name)}")
    return [by_name[node] for node in nodes] if nodes else [cluster.head()]


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


def _leave(code: int) -> NoReturn:
    raise click.exceptions.Exit(code)
