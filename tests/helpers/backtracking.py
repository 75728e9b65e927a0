"""Find patterns whose matching may take a time that grows faster than the text that they see.

A backtracking engine tries again what it has tried where two repeats without an end can share the
same characters: ``\\d+\\.?\\d*`` fails on ``111...1x`` after as many tries as the square of its
length. A search tries at each place, as if ``.*`` stood in front of it.

::

    repeat A ── needed characters ── repeat B ── something that may fail, and leads back to A
        └────────── a character that is in all of these ──────────┘

Possessive repeats and atomic groups give nothing back, so that none of them is an A.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

# The engine's own parser, which has no public name.
_parser: Any = re._parser  # type: ignore[attr-defined]
_compiler: Any = re._compiler  # type: ignore[attr-defined]

_SINGLE = ("LITERAL", "NOT_LITERAL", "IN", "ANY")
_REPEATS = ("MAX_REPEAT", "MIN_REPEAT", "POSSESSIVE_REPEAT")
_MANY = 64  # a repeat of no more ends soon
_ALPHABET = [*map(chr, range(256)), "\u0130", "\u0660", "\u2028", "\u3000", "\u4e2d"]


@dataclass(frozen=True)
class Piece:
    """Characters that a pattern takes: one of them, or many.

    `optional` numbers the groups around it that may be left out: what fails in one ends there.
    """

    characters: frozenset[str]
    is_endless: bool = False
    gives_back: bool = True
    is_needed: bool = True
    optional: tuple[int, ...] = ()


def backtracks(pattern: str | bytes, call: str, flags: int = 0) -> bool:
    """Tell whether a pattern, given to a function of `re`, may take more than linear time."""
    tree = _parser.parse(pattern, flags)
    front = [] if call in ("match", "fullmatch") else [Piece(frozenset(_ALPHABET), True)]
    end = [Piece(frozenset())] if call == "fullmatch" else []
    ways = _Unroller(tree.state.flags, isinstance(pattern, bytes)).unroll(list(tree))
    return any(_share([*front, *way, *end]) for way in ways)


def _share(pieces: Sequence[Piece]) -> bool:
    for (i, first), (j, second) in itertools.combinations(enumerate(pieces), 2):
        if not (first.is_endless and first.gives_back and second.is_endless):
            continue
        shared = first.characters & second.characters
        needed = [piece.characters for piece in pieces[i + 1 : j] if piece.is_needed]
        later = (piece.optional for piece in pieces[j + 1 :])
        leads_back = any(first.optional[: len(groups)] == groups for groups in later)
        if shared and leads_back and all(shared & characters for characters in needed):
            return True
    return False


def _overlap(sets: Sequence[frozenset[str]]) -> bool:
    return any(a & b for a, b in itertools.combinations(sets, 2))


class _Unroller:
    """Follows the ways through a parsed pattern."""

    def __init__(self, flags: int, is_bytes: bool) -> None:
        self._flags, self._is_bytes = flags, is_bytes
        self._numbers = itertools.count()

    def unroll(self, items: list[Any]) -> list[list[Piece]]:
        ways: list[list[Piece]] = [[]]
        for item in items:
            parts = list(self._unroll_one(item))
            ways = [way + part for way in ways for part in parts]
        return ways

    def _unroll_one(self, item: Any) -> Iterator[list[Piece]]:
        name, value = str(item[0]), item[1]
        if name in _SINGLE:
            yield [Piece(self._expand(item))]
        elif name in _REPEATS:
            least, most, body = value
            yield from self._repeat(least, most, body, name != "POSSESSIVE_REPEAT")
        elif name == "BRANCH":
            for branch in value[1]:
                yield from self.unroll(list(branch))
        elif name == "SUBPATTERN":
            yield from self.unroll(list(value[3]))
        elif name == "ATOMIC_GROUP":
            for way in self.unroll(list(value)):
                yield [replace(piece, gives_back=False) for piece in way]
        elif name == "AT" and "END" in str(value):
            yield [Piece(frozenset())]  # it may fail
        elif name == "AT" and "BEGINNING" in str(value):
            yield [Piece(frozenset("\n" if self._flags & re.MULTILINE else ""))]
        elif name in ("AT", "ASSERT", "ASSERT_NOT"):
            yield []
        else:
            raise NotImplementedError(name)

    def _repeat(self, least: int, most: int, body: Any, gives_back: bool) -> Iterator[list[Piece]]:
        ways = self.unroll(list(body))
        if most > _MANY and not any(piece.is_endless for way in ways for piece in way):
            inside = frozenset[str]().union(*(piece.characters for way in ways for piece in way))
            endless = Piece(inside, True, gives_back, least > 0)
            starts = [way[0].characters for way in ways if way]
            yield [endless, endless] if _overlap(starts) else [endless]
            return
        if not gives_back:
            ways = [[replace(piece, gives_back=False) for piece in way] for way in ways]
        if least == 0:
            number = next(self._numbers)
            ways = [[replace(p, optional=(number, *p.optional)) for p in way] for way in ways]
            yield []
        yield from ways
        yield from (a + b for a in ways for b in ways if most > 1)

    def _expand(self, item: Any) -> frozenset[str]:
        """Return the characters that one item matches."""
        state = _parser.State()
        state.flags, state.str = self._flags, b"" if self._is_bytes else ""
        compiled = _compiler.compile(_parser.SubPattern(state, [item]), self._flags)
        letters = _ALPHABET[:256] if self._is_bytes else _ALPHABET
        return frozenset(
            c for c in letters if compiled.fullmatch(c.encode("latin-1") if self._is_bytes else c)
        )
