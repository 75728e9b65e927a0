from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.protocol.messages import Share
from hpccomponent.protocol.shelf import MAX_BLOBS, Shelf


def share(number: int, size: int = 10) -> Share:
    return Share("s", number.to_bytes(16, "little"), b"", [size])


def key(number: int) -> bytes:
    return share(number).key


def test_the_least_recently_used_goes_first_and_what_is_needed_stays() -> None:
    shelf = Shelf(20)
    for number in range(4):
        assert shelf.put(share(number))
    assert not shelf.put(share(0))
    assert shelf.use([key(0), key(9)]) == [key(9)]
    assert shelf.is_full()
    assert shelf.evict({key(1)}) == [key(2), key(3)]
    assert not shelf.is_full()


def test_what_is_forgotten_goes_as_soon_as_nothing_needs_it() -> None:
    shelf = Shelf(1000)
    shelf.put(share(1))
    shelf.forget([key(1), key(2)])
    assert shelf.evict({key(1)}) == []
    assert shelf.is_full()
    assert shelf.evict(set()) == [key(1)]
    assert not shelf.is_full()


def test_a_blob_that_comes_again_is_no_longer_forgotten() -> None:
    shelf = Shelf(1000)
    shelf.put(share(1))
    shelf.forget([key(1)])
    shelf.put(share(1))
    assert shelf.evict(set()) == []


def test_the_worker_gets_each_blob_once_and_again_after_it_went() -> None:
    shelf = Shelf(0)
    shelf.put(share(1))
    assert shelf.hand_over([key(1)]) == [key(1)]
    assert shelf.hand_over([key(1)]) == []
    assert shelf.evict(set()) == [key(1)]
    shelf.put(share(1))
    assert shelf.hand_over([key(1)]) == [key(1)]
    shelf.worker_has.clear()  # it died
    assert shelf.hand_over([key(1)]) == [key(1)]


@given(
    st.lists(st.tuples(st.integers(0, MAX_BLOBS * 2), st.integers(0, 50)), max_size=60),
    st.sets(st.integers(0, 60)),
)
def test_the_limit_holds_but_for_what_is_needed(
    blobs: list[tuple[int, int]], needed: set[int]
) -> None:
    shelf = Shelf(100)
    sizes = {number: size for number, size in blobs if shelf.put(share(number, size))}
    gone = shelf.evict({key(number) for number in needed})
    kept = {number: size for number, size in sizes.items() if key(number) not in gone}
    assert needed & sizes.keys() <= kept.keys()
    assert sum(size for number, size in kept.items() if number not in needed) <= 100
