"""Whether the files of a job are aligned before they are joined."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hpcapp.io.points.inputs import Place
    from hpcapp.io.points.point_source import PointSource


def choose_place(is_asked: bool) -> Place | None:
    """Return what `gather_points` brings files into one frame with; None where they lie in one."""
    if not is_asked:
        return None

    def place(sources: Sequence[PointSource], names: Sequence[str]) -> Sequence[PointSource]:
        from hpcapp.alignment.sources import align_sources

        return align_sources(sources, names)[0]

    return place
