"""The files beside a textured OBJ are named after it, one to one, as every reader takes a name."""

from __future__ import annotations

import os
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from hpcapp.io.meshes.mtl import name_texture_files

STEMS = st.one_of(
    st.text(" _~a-2#0.ÿé\u00a0", min_size=1),
    st.binary(min_size=1).map(lambda raw: os.fsdecode(raw.replace(b"/", b"").replace(b"\0", b""))),
).filter(lambda stem: stem not in ("", ".", ".."))
NAMES = st.builds("{}{}".format, STEMS, st.sampled_from([".obj", ".OBJ", ".Obj"]))


@given(st.lists(NAMES, unique=True, min_size=2))
def test_two_meshes_never_share_a_file(names: list[str]) -> None:
    files = [file for name in names for file in name_texture_files(Path("folder", name))]
    assert len({*files}) == 3 * len(names)


@given(NAMES)
def test_a_name_is_one_word_that_no_reader_takes_for_more(name: str) -> None:
    for file in name_texture_files(Path("folder", name)):
        assert file.parent == Path("folder")
        assert len(file.name.encode().split()) == 1
        assert not {*file.name} & {*"#\\\"'%?"}
        assert not file.name.startswith("-")


def test_usual_names_stay() -> None:
    names = [file.name for file in name_texture_files(Path("my_scan-2.obj"))]
    assert names == ["my_scan-2.mtl", "my_scan-2_colours.png", "my_scan-2_normals.png"]
