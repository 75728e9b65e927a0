"""Tiles that a process has begun and not finished: a bounded cache by ticket."""

from __future__ import annotations

from hpcapp.applications.surface.tiles.prepared import PreparedTile


class TileCache:
    """Prepared tiles by their tickets, `capacity` at most, the oldest given up first."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._tiles: dict[str, PreparedTile] = {}

    def __len__(self) -> int:
        return len(self._tiles)

    def put(self, ticket: str, tile: PreparedTile) -> None:
        """Keep a tile; where there is no room the oldest goes."""
        while len(self._tiles) >= self._capacity:
            self._tiles.pop(next(iter(self._tiles), ""), None)
        self._tiles[ticket] = tile

    def pop(self, ticket: str | None) -> PreparedTile | None:
        """Take a tile out; None where it is not here any more."""
        return None if ticket is None else self._tiles.pop(ticket, None)

    def advance(self, ticket: str) -> bool:
        """Do a step of a tile ahead of time, and tell whether there are more.

        A step that fails gives the tile up: who asks for it prepares it anew, and meets the error
        if it stays.
        """
        if ticket not in self._tiles:
            return False
        try:
            return self._tiles[ticket].lay_some()
        except BaseException:
            del self._tiles[ticket]
            raise
