from collections.abc import Callable
from pathlib import Path

import pytest

from hpcapp.io.meshes.off import read_off
from hpccomponent.errors import InputError

Make = Callable[..., Path]
SQUARE = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


@pytest.mark.parametrize("head", ["OFF\n4 1 0\n", "OFF 4 1 0\n", "# c\nOFF\n\n4 1 # no edges\n"])
@pytest.mark.parametrize("face", ["4 0 1 2 3\n", "4 0 1 2 3 0.5 0.5 0.5\n"])
def test_heads_and_faces_in_every_spelling(make_file: Make, head: str, face: str) -> None:
    mesh = read_off(make_file("a.off", head + SQUARE + face))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("COFF\n4 1 0\n", ":1: not an OFF file: it starts with 'COFF'"),
        ("OFF\n4 many 0\n", ":2: not the counts"),
        ("OFF\n4000000000 1 0\n" + SQUARE, "4000000000 vertices are announced.* after 4"),
        ("OFF\n4 2 0\n" + SQUARE + "3 0 1 2\n", "2 faces are announced, the file ends after 1"),
        ("OFF\n4 1 0\n" + SQUARE + "3 0 1 2\n3 0 2 3\n", ":8: lines follow after the last face"),
        ("OFF\n4 1 0\n" + SQUARE + "3 0 1\n", ":7: not a face"),
        ("OFF\n4 1 0\n" + SQUARE + "3 0 1 b\n", ":7: not a face"),
        ("OFF\n4 1 0\n" + SQUARE + "3 0 1 " + "9" * 25, ":7: not a face"),
        ("OFF\n4 1 0\n" + SQUARE + "-1 0 1\n", ":7: not a face"),
        ("OFF\n3 2 0\n" + SQUARE + "3 0 1 2\n", "not a face|has 0 corners|names vertex"),
        ("OFF\n4 1 0\n0 0 0\n1 0 0\n1,5 1 0\n0 1 0\n3 0 1 2\n", ":5: '1,5' is not a number"),
    ],
)
def test_wrong_lines_are_named(make_file: Make, content: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_off(make_file("bad.off", content))
