from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from hpccomponent.errors import ProtocolError, UsageError
from hpccomponent.protocol.codec import RECORD, decode_values, encode_values
from hpccomponent.protocol.declared import Record, Whole, check_result
from hpccomponent.protocol.declared_arrays import Array
from hpccomponent.protocol.records import make_record, record


@record("tests.pair")
@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    rows: NDArray[np.generic]
    count: int
    inner: Pair | None = None


def test_a_record_comes_back_as_itself_large_arrays_and_inner_ones_too() -> None:
    sent = Pair(np.arange(10_000), 3, Pair(np.zeros((2, 3), np.float32), -1))
    header, buffers = encode_values((sent, (sent, [1.5])))
    assert len(buffers) == 2
    back, (again, rest) = decode_values(header, buffers)
    assert type(back) is type(again) is Pair
    assert rest == [1.5]
    assert back.inner is not None
    np.testing.assert_array_equal(back.rows, sent.rows)
    assert (back.count, back.inner.count, back.inner.inner) == (3, -1, None)


def test_what_a_record_holds_must_be_able_to_travel() -> None:
    with pytest.raises(UsageError, match="cannot travel"):
        encode_values((Pair(np.arange(3), object()),))  # type: ignore[arg-type]


def test_a_dataclass_that_is_not_registered_does_not_travel() -> None:
    @dataclass(frozen=True)
    class Unknown:
        count: int

    with pytest.raises(UsageError, match="cannot travel"):
        encode_values((Unknown(1),))


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("tests.unknown", {"rows": None, "count": 1, "inner": None}),
        ("os.system", {"command": "true"}),
        ("tests.pair", {}),
        ("tests.pair", {"rows": None, "count": 1}),
        ("tests.pair", {"count": 1, "rows": None, "inner": None}),
        ("tests.pair", {"rows": None, "count": 1, "inner": None, "more": 1}),
        ("", {"rows": None, "count": 1, "inner": None}),
    ],
)
def test_a_message_can_ask_for_registered_classes_with_their_fields_only(
    name: str, fields: dict[str, object]
) -> None:
    with pytest.raises(ProtocolError, match="record"):
        make_record(name, fields)
    with pytest.raises(ProtocolError, match="record"):
        decode_values(msgspec.msgpack.encode([[RECORD, name, fields]]), [])


@pytest.mark.parametrize(
    "entry", [[RECORD], [RECORD, "tests.pair"], [RECORD, 1, {}], [RECORD, "tests.pair", [8]],
              [RECORD, "tests.pair", {}, 1]],
)  # fmt: skip
def test_a_record_of_another_form_is_refused(entry: list[object]) -> None:
    with pytest.raises(ProtocolError):
        decode_values(msgspec.msgpack.encode([entry]), [])


def test_records_nested_without_end_are_refused_at_either_side() -> None:
    deep = Pair(np.zeros(1), 0)
    entry: object = [RECORD, "tests.pair", {"rows": None, "count": 1, "inner": None}]
    for _ in range(100):
        deep = Pair(deep.rows, 0, deep)
        entry = [RECORD, "tests.pair", {"rows": None, "count": 1, "inner": entry}]
    with pytest.raises(UsageError, match="nested"):
        encode_values((deep,))
    with pytest.raises(ProtocolError, match="nested"):
        decode_values(msgspec.msgpack.encode([entry]), [])


def test_only_frozen_dataclasses_that_keep_their_fields_are_registered() -> None:
    @dataclass
    class Changes:
        count: int

    @dataclass(frozen=True)
    class Does:
        count: int

        def __post_init__(self) -> None:
            raise AssertionError

    class Plain:
        pass

    kinds: list[type] = [Changes, Does, Plain]
    for kind in kinds:
        with pytest.raises(TypeError):
            record("tests.refused")(kind)


def test_a_name_stands_for_one_class() -> None:
    @dataclass(frozen=True)
    class Other:
        count: int

    with pytest.raises(ValueError, match="already"):
        record("tests.pair")(Other)


def small(**changes: Any) -> Pair:
    given: dict[str, Any] = {"rows": np.zeros((2, 3)), "count": 2}
    return Pair(**given | changes)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: (np.zeros((2, 3)), 2, None), "of type tuple, not Pair"),
        (lambda: small(rows=np.zeros((2, 2))), r"result\.rows has the shape"),
        (lambda: small(rows=np.full((2, 3), np.nan)), r"result\.rows has entries that are NaN"),
        (lambda: small(count=True), r"result\.count is of type bool"),
        (lambda: small(count=-1), r"result\.count is not from"),
    ],
)
def test_a_declared_record_is_checked_field_by_field(
    make: Callable[[], object], complaint: str
) -> None:
    pattern = Record(Pair, rows=Array("<f8", "n", 3), count=Whole())
    check_result(pattern, small())
    with pytest.raises(ProtocolError, match=complaint):
        check_result(pattern, make())


def test_fields_keep_their_order() -> None:
    back = make_record("tests.pair", {"rows": 1, "count": 2, "inner": None})
    assert astuple(back) == (1, 2, None)
