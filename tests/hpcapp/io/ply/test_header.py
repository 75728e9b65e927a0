from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hpcapp.io.ply.header import SCALAR_TYPES, Element, Property, read_header
from hpccomponent.errors import InputError

XYZ = "property float x\nproperty float y\nproperty float z\n"
names = st.text("abcxyz_0123456789", min_size=1, max_size=8)
types = st.sampled_from(sorted(SCALAR_TYPES))
count_types = st.sampled_from(sorted(t for t, d in SCALAR_TYPES.items() if d[0] != "f"))
properties = st.lists(
    st.tuples(names, types, st.none() | count_types),
    min_size=1,
    max_size=6,
    unique_by=lambda p: p[0],
)
elements = st.lists(
    st.tuples(names, st.integers(0, 2**40), properties), max_size=4, unique_by=lambda e: e[0]
)


def spell(element: tuple[str, int, list[tuple[str, str, str | None]]]) -> list[str]:
    name, count, its = element
    return [f"element {name} {count}"] + [
        f"property list {c} {t} {n}" if c else f"property {t} {n}" for n, t, c in its
    ]


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None
)
@given(
    elements,
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]),
    st.sampled_from(
        [
            "comment element vertex 9",
            "obj_info end_header",
            "comment",
            "",
            "comment \x85 \x0b\x1c ą",
        ]
    ),
)
def test_any_header_is_understood(
    make_file: Callable[..., Path],
    drawn: list[tuple[str, int, list[tuple[str, str, str | None]]]],
    newline: str,
    encoding: str,
    remark: str,
) -> None:
    lines = ["ply", remark, f"format {encoding} 1.0", remark]
    lines += [line for element in drawn for line in [*spell(element), remark]]
    head = newline.join([*lines, "end_header", ""]).encode()
    header = read_header(make_file("made.ply", head + b"\n\r\0"))
    assert header.body_start == len(head)
    assert header.body_line == len(lines) + 2
    assert (
        header.byte_order
        == {"a": "", "l": "<", "b": ">"}[encoding.split("_")[-2][0] if "_" in encoding else "a"]
    )
    assert header.elements == tuple(
        Element(n, c, tuple(Property(p, SCALAR_TYPES[t], k and SCALAR_TYPES[k]) for p, t, k in its))
        for n, c, its in drawn
    )


def test_a_line_without_a_keyword_is_passed_over(make_file: Callable[..., Path]) -> None:
    lines = "ply\nformat ascii 1.0\nCreated by hand\nelement vertex 0\nproperty int x\nend_header\n"
    header = read_header(make_file("odd.ply", lines))
    assert header.elements == (Element("vertex", 0, (Property("x", "i4"),)),)
    assert header.warnings == ("line 3 of the header has no keyword: 'Created by hand'",)


@pytest.mark.parametrize("start", [b"ply \n", b"ply\t\r\n", b"\xef\xbb\xbfply\n"])
def test_odd_first_lines(make_file: Callable[..., Path], start: bytes) -> None:
    assert (
        read_header(make_file("odd.ply", start + b"format ascii 1.0\nend_header\n")).body_line == 4
    )


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"solid cube\n", "not a PLY file"),
        (b"plywood\n", "not a PLY file"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\n", "no 'end_header'"),
        (b"ply\nelement vertex 0\nend_header\n", "no 'format' line"),
        (b"ply\nformat ascii 1.0\nelement vertex 3\nend_header\n", "'vertex' has no properties"),
    ],
)
def test_what_is_no_ply_is_refused(
    make_file: Callable[..., Path], content: bytes, said: str
) -> None:
    path = make_file("bad.ply", content)
    with pytest.raises(InputError, match=said) as refusal:
        read_header(path)
    assert str(path) in refusal.value.problem
    assert refusal.value.advice


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("format ascii 2.0", "cannot make sense"),
        ("format ascii 1.0", "cannot make sense"),  # a second one
        ("element vertex", "cannot make sense"),
        ("element vertex -3", "cannot make sense"),
        ("element vertex 1e6", "cannot make sense"),
        ("element vertex " + "9" * 5000, "cannot make sense"),
        ("property float x", "before any element"),
        ("element v 1\nproperty quad x", "unknown type 'quad'"),
        ("element v 1\nproperty list float int x", "whose length is a float"),
        ("element v 1\nproperty float x\nproperty int x", "a second property 'x'"),
        ("element v 1\nproperty int x\nelement v 1", "a second element 'v'"),
    ],
)
def test_a_wrong_line_is_named(make_file: Callable[..., Path], line: str, said: str) -> None:
    path = make_file("bad.ply", f"ply\nformat ascii 1.0\n{line}\nend_header\n")
    number = 3 + line.count("\n")
    with pytest.raises(InputError, match=rf":{number}: PLY header: .*{said}"):
        read_header(path)
