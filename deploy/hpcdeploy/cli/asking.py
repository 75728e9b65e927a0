"""Questions to the user; where nobody can answer them, which option answers instead."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import click

from hpccomponent.cli.terminal import echo
from hpccomponent.cli.verbosity import is_quiet
from hpccomponent.errors import CloudError, UsageError

if TYPE_CHECKING:
    from hpcdeploy.provider import Observed
    from hpcdeploy.reconcile.cluster import Cluster


T = TypeVar("T")

_NEWLINE_OF_OTHERS = re.compile(r"\n(?! {4})")


def say(line: str) -> None:
    """Tell the user something that no script reads, and that is no error.

    A block of somebody else's words may stand below it, see `write_block`. Any other newline comes
    from a machine that would say a line of ours, right before a question perhaps: it is written
    out.
    """
    if not is_quiet():
        echo(_NEWLINE_OF_OTHERS.sub(r"\\n", line), err=True)


def ask_to_go_on(cluster: Cluster) -> None:
    """Ask whether to go on; raise UsageError where nobody has answered with yes."""
    _ask(cluster, lambda: click.confirm("Go on?", abort=True, err=True), "run it with -y")


def ask_name(cluster: Cluster, purpose: str, advice: str) -> None:
    """Let the user type the cluster's name, so that the right one is meant.

    `purpose` is what is done to it, as an infinitive: "take it away".
    """
    question = f"Type the cluster's name to {purpose}"
    typed = _ask(cluster, lambda: str(click.prompt(question, err=True)), advice)
    if typed.strip() != cluster.spec.cluster:
        raise CloudError(f"{typed!r} is not its name: nothing was done", advice)


def name_foreign(
    cluster: Cluster, purpose: str, *, is_asked: bool, given: str = ""
) -> Observed | None:
    """Let the user name a cluster that was made elsewhere; return what it was then.

    None where it was made here. `purpose` is what is done to it, as an infinitive: "take it away";
    `given` the name from the command line, empty where there is none. Only with `is_asked` may the
    user be asked to type the name.

    Raises CloudError where the cluster is not named, with whose it is; UsageError where another one
    is named, or nobody has answered.
    """
    from hpcdeploy.reconcile.cluster import require_ours

    name = cluster.spec.cluster
    if given not in ("", name):
        raise UsageError(f"the file's cluster is {name}, not {given}", "give the right file")
    observed = cluster.provider.observe(name)
    try:
        require_ours(cluster, observed)
    except CloudError as error:
        advice = f"give --name {name} to {purpose}"
        if given != name:
            if not is_asked:
                raise CloudError(error.problem, advice) from None
            say(error.problem)
            ask_name(cluster, purpose, advice)
        return observed
    return None


def _ask(cluster: Cluster, ask: Callable[[], T], advice: str) -> T:
    if is_quiet():  # what is asked about has not been said
        raise UsageError("-q shows no question", advice)
    try:
        return ask()
    except click.Abort:
        if sys.stdin.isatty():
            raise
        say("")  # the question's own line is not ended
        raise UsageError(
            f"cluster {cluster.spec.cluster} is not changed: this is not a terminal, and the "
            "question was not answered with yes or its name",
            advice,
        ) from None
