"""Run every command that the tutorial and the how-to pages show: python docs/run_commands.py.

Blocks marked ``sh`` are run, those of one page one after the other in a temporary folder, by the
programs of the environment that runs this script. Each line of a block marked ``output`` must be
among those that the ``sh`` block before it prints, but for ``...``; dates, times, build names,
widths of columns and the temporary folder, ``/home/me`` on a page, may differ, and numbers by a
twentieth. Blocks marked ``text`` need what a page
cannot assume (a cluster, a clone), or are output that is not compared. A page must leave no
cluster of folders behind.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).parent
BLOCK = re.compile(r"^( *)```(sh|output)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
TIMEOUT_S = 300
HOME = "/home/me"
CLUSTERS = ".local/state/hpcapp/clusters"
BETWEEN = "==== the next block"
VARYING = (
    (re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d)?"), "DATE"),
    (re.compile(r"\b(\d+s|\d+[hm]\d\d|\d+\.\d+ s)\b"), "TIME"),
    (re.compile(r"\b(native|portable)(-[0-9a-z._]+)*"), "BUILD"),
    (re.compile(r" +"), " "),
)
NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
TOLERANCE = 0.05


class Block(NamedTuple):
    """Commands, and lines that they must print.

    Parameters
    ----------
    commands : str
        Of a shell.
    output : tuple of str
        Lines, as the page has them.
    """

    commands: str
    output: tuple[str, ...] = ()


def find_blocks(page: str) -> list[Block]:
    r"""Return the blocks of a page that are to be run.

    Parameters
    ----------
    page : str
        The text of the page.

    Examples
    --------
    >>> find_blocks("```sh\nls\n```\n```output\na\n```\n```text\nb\n```\n")
    [Block(commands='ls\n', output=('a',))]
    """
    blocks: list[Block] = []
    for _, kind, text in BLOCK.findall(page):
        if kind == "sh":
            blocks.append(Block(text))
        else:
            blocks[-1] = Block(blocks[-1].commands, (*blocks[-1].output, *text.splitlines()))
    return blocks


def run_page(path: Path) -> str | None:
    """Run the commands of a page.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str or None
        What the commands have printed where one of them failed, or what else is wrong.
    """
    blocks = find_blocks(path.read_text(encoding="utf-8"))
    if not blocks:
        return None
    script = f"{{ echo '{BETWEEN}'; }} 2>/dev/null\n".join(block.commands for block in blocks)
    with tempfile.TemporaryDirectory() as folder:
        try:
            done = _run_shell(script, folder)
        finally:
            left = _take_down(Path(folder))
    if done.returncode or left:
        return done.stdout + left
    said = done.stdout.replace(folder, HOME).split(f"{BETWEEN}\n")
    missing = [
        f"not printed: {line}"
        for block, printed in zip(blocks, said, strict=True)
        for line in _missing(block.output, printed.splitlines())
    ]
    return "\n".join([done.stdout, *missing]) if missing else None


def _run_shell(script: str, folder: str) -> subprocess.CompletedProcess[str]:
    programs = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    return subprocess.run(
        ["/bin/bash", "-euxo", "pipefail", "-c", script],
        cwd=folder,
        env=os.environ | {"PATH": programs, "HOME": folder},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


def _take_down(folder: Path) -> str:
    """Take away the clusters of folders that a page has left; say which they are."""
    left = sorted(path.name for path in (folder / CLUSTERS).glob("*/nodes"))
    if not left:
        return ""
    for path in sorted(folder.glob("*.yaml")):
        if "type: local" in path.read_text(encoding="utf-8"):
            _run_shell(f"hpcapp down -y {path.name}", str(folder))
    return f"{len(left)} cluster was left behind; hpcapp down takes it away\n"


def _missing(expected: Sequence[str], printed: Sequence[str]) -> list[str]:
    """Return the lines of a page that were not printed, in whatever order.

    Examples
    --------
    >>> _missing(["1,000 points", "...", "2 pieces"], ["1,049 points", "3 pieces"])
    ['2 pieces']
    """
    found: dict[str, list[list[float]]] = {}
    for line in printed:
        words, numbers = _split_numbers(line)
        found.setdefault(words, []).append(numbers)
    lacking = []
    for line in expected:
        words, numbers = _split_numbers(line)
        alike = (
            all(abs(a - b) <= TOLERANCE * abs(b) for a, b in zip(seen, numbers, strict=True))
            for seen in found.get(words, [])
        )
        if words != "..." and not any(alike):
            lacking.append(line)
    return lacking


def _split_numbers(line: str) -> tuple[str, list[float]]:
    """Return the words of a line, each number a sign, and the numbers."""
    words = _normalise(line)
    numbers = [float(number.replace(",", "")) for number in NUMBER.findall(words)]
    return NUMBER.sub("#", words), numbers


def _normalise(line: str) -> str:
    for pattern, word in VARYING:
        line = pattern.sub(word, line)
    return line.strip()


def main(pages: Sequence[str]) -> int:
    """Run pages, all by default; return 1 where a command of one failed."""
    found = [*sorted(DOCS.glob("tutorial/*.md")), *sorted(DOCS.glob("how-to/*.md"))]
    code = 0
    for path in map(Path, pages) if pages else found:
        count = len(find_blocks(path.read_text(encoding="utf-8")))
        failed = run_page(path)
        outcome = "fine" if failed is None else "failed"
        print(f"{os.path.relpath(path)}: {count} blocks, {outcome}", flush=True)
        if failed is not None:
            print(failed)
            code = 1
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
