"""``python -m hpcloader``: run the loader, or show what it knows of this machine."""

from __future__ import annotations

import argparse
import dataclasses
import json
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from hpccomponent.cli.terminal import VisibleFormatter, visible_text
from hpccomponent.errors import ConfigError, HpcError
from hpccomponent.runtime.garbage_collection import rare_collections
from hpcloader.builds import BUILD_VARIABLE, BUILDS, BuildChoice, choose_build
from hpcloader.daemon import Daemon
from hpcloader.machine import Machine, read_machine
from hpcloader.settings import LoaderSettings
from hpcloader.supervisor import RestartRule, Supervisor

logger = logging.getLogger("hpcloader")

_AT_HAND = RestartRule(first_s=0.1, cap_s=2.0)  # without a file: somebody waits for the worker
_VECTOR_FLAGS = ("sse4", "avx", "fma", "asimd", "sve")  # the few of a hundred that people look for


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb of the command line and return its exit code: 0 where all went well.

    Others are `HpcError.exit_code` and `End.exit_code`. Raise SystemExit where the arguments are
    wrong, or only ask for help.
    """
    arguments = _parser().parse_args(argv)
    try:
        return int(arguments.verb(arguments))
    except HpcError as error:
        sys.stderr.write(visible_text(f"hpcloader: {error}\n"))
        return error.exit_code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("hpcloader", description="Starts the worker build that fits.")
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    run = verbs.add_parser("run", help="start a component and watch over it")
    source = run.add_mutually_exclusive_group(required=True)
    source.add_argument("--config", type=Path, metavar="FILE", help="loader.yaml")
    source.add_argument(
        "--connection", type=Path, metavar="FILE", help="instead: the connection file alone"
    )
    run.add_argument(
        "--task", action="append", default=[], metavar="NAME=module:function", help="a further task"
    )
    run.add_argument(
        "--lifeline-fd", type=int, metavar="N", help="leave when this pipe comes to its end"
    )
    run.set_defaults(verb=_run)
    facts = verbs.add_parser("facts", help="show this machine's facts and the chosen build")
    facts.add_argument("--json", action="store_true", help="one JSON object")
    facts.add_argument("--catalogue", type=Path, metavar="FILE", help="instead of the loader's own")
    facts.set_defaults(verb=_facts)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    settings = _settings(arguments)
    lines = logging.StreamHandler(sys.stderr)
    lines.setFormatter(
        VisibleFormatter(f"%(asctime)s %(levelname)s loader {settings.name}: %(message)s")
    )
    logging.basicConfig(level=logging.INFO, handlers=[lines])
    choice = choose_build(settings.builds, read_machine(), os.environ.get(BUILD_VARIABLE, ""))
    for name, reason in choice.passed_over:
        logger.info("build %s passed over: %s", name, reason)
    logger.info("build %s chosen", choice.build.name)
    supervisor = Supervisor(settings.restart)
    return Daemon(component_argv(settings, choice), supervisor, arguments.lifeline_fd).run()


def _settings(arguments: argparse.Namespace) -> LoaderSettings:
    """Return what the file says, or the command line."""
    tasks = tuple(arguments.task)
    if arguments.config is not None:
        from hpcloader.files import read_settings

        settings = read_settings(arguments.config)
        return dataclasses.replace(settings, tasks=(*settings.tasks, *tasks))
    connection = arguments.connection.absolute()
    if not connection.is_file():
        raise ConfigError(
            f"{connection}: no such file", "the master or the deployment writes it; give its path"
        )
    return LoaderSettings(connection.parent.name, connection, tasks, _AT_HAND)


def component_argv(settings: LoaderSettings, choice: BuildChoice) -> list[str]:
    """Return the component's command line, without its lifeline."""
    connection = ["--connection", str(settings.connection), "--build", choice.build.name]
    tasks = [word for task in (*choice.build.tasks, *settings.tasks) for word in ("--task", task)]
    return [*choice.build.argv(), *connection, *tasks]


def _facts(arguments: argparse.Namespace) -> int:
    builds, machine = BUILDS, read_machine()
    if arguments.catalogue is not None:
        from hpcloader.files import read_catalogue

        builds = read_catalogue(arguments.catalogue)
    choice = choose_build(builds, machine, os.environ.get(BUILD_VARIABLE, ""))
    text = _facts_json(machine, choice) if arguments.json else _facts_text(machine, choice)
    sys.stdout.write(text + "\n")
    return 0


def _facts_json(machine: Machine, choice: BuildChoice) -> str:
    facts = dataclasses.asdict(machine) | {"cpu_flags": sorted(machine.cpu_flags)}
    passed_over = [{"build": name, "reason": reason} for name, reason in choice.passed_over]
    command = choice.build.argv()
    return json.dumps(
        {
            "machine": facts,
            "build": choice.build.name,
            "command": command,
            "passed_over": passed_over,
        }
    )


def _facts_text(machine: Machine, choice: BuildChoice) -> str:
    vectors = sorted(flag for flag in machine.cpu_flags if flag.startswith(_VECTOR_FLAGS))
    rows = [
        ("architecture", machine.architecture),
        ("vector flags", " ".join(vectors) or "none"),
        ("cores", str(machine.cores)),
        ("memory", f"{machine.memory / 2**30:.1f} GiB"),
        ("GPUs", ", ".join(machine.gpus) or "none"),
        ("system", machine.system),
        ("C library", machine.libc or "unknown"),
        ("Python", machine.python),
        *(("passed over", f"{name}: {reason}") for name, reason in choice.passed_over),
        ("build", f"{choice.build.name}: {' '.join(choice.build.argv())}"),
    ]
    return "\n".join(f"{label:<13} {value}" for label, value in rows)


if __name__ == "__main__":
    with rare_collections():
        code = main()
    sys.exit(code)
