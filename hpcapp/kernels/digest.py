"""What of some Python files can decide the bits of a result: their code, without its prose.

The build runs this file as a program (see ``CMakeLists.txt``), so that it imports nothing of the
package; the portable build calls it.
"""

from __future__ import annotations

import ast
import hashlib
import re
import sys
from pathlib import Path

SUBJECTS = ("geometry", "kernels", *(f"applications/surface/{subject}" for subject in (
    "attributes", "boundary", "cleaning", "cloud", "extraction", "field", "normals", "paper",
    "reading", "scale", "stitching", "tiles", "types",
)))  # fmt: skip
"""The folders of the package with what workers run; all other code is the master's alone."""

_DIGITS = 12

_STRING_OR_COMMENT = re.compile(
    r"""(?P<string>\"{3}(?:\\.|[^\\])*?\"{3}|'{3}(?:\\.|[^\\])*?'{3}"""
    r"""|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')|[ \t]*\#[^\n]*""",
    re.DOTALL,
)


def strip_prose(source: str) -> str:
    r"""Return a module's code without docstrings, comments and blank lines.

    The module must be one that can be parsed. Two that differ in prose only give the same; any
    other change shows.

    Examples
    --------
    >>> strip_prose('def f(x):\n    "Twice x."\n    return 2 * x  # exact\n')
    'def f(x):\n    return 2 * x'
    """
    lines = source.splitlines()
    for owner in ast.walk(ast.parse(source)):
        body = getattr(owner, "body", ())
        for node in body if isinstance(body, list) else ():
            if _is_prose(node):
                rows = range(node.lineno - 1, node.end_lineno)
                for row in rows:
                    lines[row] = ""
                if body == [node]:  # something must stand there
                    lines[rows[0]] = " " * node.col_offset + "pass"
    bare = _STRING_OR_COMMENT.sub(lambda match: match["string"] or "", "\n".join(lines))
    return "\n".join(line for line in bare.split("\n") if line.strip())


def _is_prose(node: ast.AST) -> bool:
    """Tell whether a statement is a string and nothing else."""
    match node:
        case ast.Expr(value=ast.Constant(value=str())):
            return True
    return False


def digest_code(folder: Path) -> str:
    """Return a digest of the code that workers run, 12 hexadecimal digits.

    All Python files in the package's `SUBJECTS` count, at any depth, with their names.
    """
    total = hashlib.sha256()
    for file in sorted(file for subject in SUBJECTS for file in (folder / subject).rglob("*.py")):
        name = file.relative_to(folder).as_posix()
        total.update(f"{name}\0{strip_prose(file.read_text(encoding='utf-8'))}\0".encode())
    return total.hexdigest()[:_DIGITS]


if __name__ == "__main__":
    sys.stdout.write(digest_code(Path(sys.argv[1])))
