"""Run every command that the tutorial and the how-to pages show: python docs/run_commands.py.

Blocks marked ``sh`` are run, those of one page one after the other in a temporary folder, by the
programs of the environment that runs this script. Blocks marked ``text`` are output, or need what
a page cannot assume (a cluster, a clone).
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

DOCS = Path(__file__).parent
BLOCK = re.compile(r"^( *)```sh\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
TIMEOUT_S = 300


def find_commands(page: str) -> list[str]:
    r"""Return the blocks of a page that are to be run.

    Parameters
    ----------
    page : str
        The text of the page.

    Examples
    --------
    >>> find_commands("```sh\nls\n```\n```text\noutput\n```\n")
    ['ls\n']
    """
    return [block for _, block in BLOCK.findall(page)]


def run_page(path: Path) -> str | None:
    """Run the commands of a page.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str or None
        What the commands have printed where one of them failed.
    """
    script = "".join(find_commands(path.read_text(encoding="utf-8")))
    if not script:
        return None
    with tempfile.TemporaryDirectory() as folder:
        programs = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
        done = subprocess.run(
            ["/bin/bash", "-euxo", "pipefail", "-c", script],
            cwd=folder,
            env=os.environ | {"PATH": programs, "HOME": folder},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
    return done.stdout if done.returncode else None


def main(pages: Sequence[str]) -> int:
    """Run pages, all by default; return 1 where a command of one failed."""
    found = [*sorted(DOCS.glob("tutorial/*.md")), *sorted(DOCS.glob("how-to/*.md"))]
    code = 0
    for path in map(Path, pages) if pages else found:
        count = len(find_commands(path.read_text(encoding="utf-8")))
        failed = run_page(path)
        outcome = "fine" if failed is None else "failed"
        print(f"{os.path.relpath(path)}: {count} blocks, {outcome}", flush=True)
        if failed is not None:
            print(failed)
            code = 1
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
