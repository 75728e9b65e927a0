"""Start a component: ``python -P -m hpccomponent --connection FILE``."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys

from hpccomponent.cli.terminal import VisibleFormatter, visible_text
from hpccomponent.errors import HpcError
from hpccomponent.protocol.connection import read_connection
from hpccomponent.ranges import check_range
from hpccomponent.runtime.component import ComponentOptions, run_component
from hpccomponent.runtime.garbage_collection import rare_collections
from hpccomponent.runtime.lifetime import die_with_parent
from hpccomponent.runtime.tasks import TaskRegistry


def main(arguments: list[str] | None = None) -> int:
    """Run a component, and return its `ExitCode`."""
    options = _parse(arguments)
    lines = logging.StreamHandler(sys.stderr)
    lines.setFormatter(VisibleFormatter(f"hpccomponent[{os.getpid()}] %(levelname)s %(message)s"))
    logging.basicConfig(handlers=[lines])
    if options.lifeline_fd is not None:
        die_with_parent(os.getppid(), signal.SIGTERM)
    try:
        check_range("--silence", options.silence, 0.0)
        connection = read_connection(options.connection)
        TaskRegistry(options.task)  # a malformed entry is found here, not in the worker
        return run_component(
            connection,
            ComponentOptions(options.build, options.task, options.lifeline_fd, options.silence),
        )
    except HpcError as error:
        sys.stderr.write(visible_text(f"hpccomponent: {error}\n"))
        return error.exit_code


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m hpccomponent",
        description="Wrap one worker: register with the master, run its tasks.",
        allow_abbrev=False,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--connection", required=True, metavar="FILE", help="connection file")
    parser.add_argument("--build", default="portable", metavar="NAME", help="worker build")
    parser.add_argument(
        "--task", action="append", default=[], metavar="NAME=module:function", help="a further task"
    )
    parser.add_argument(
        "--lifeline-fd", type=int, metavar="N", help="leave when the other end of this pipe closes"
    )
    parser.add_argument(
        "--silence", type=float, default=60.0, metavar="S", help="wait so long for a master, in s"
    )
    return parser.parse_args(arguments)


if __name__ == "__main__":
    with rare_collections():
        code = main()
    sys.exit(code)
