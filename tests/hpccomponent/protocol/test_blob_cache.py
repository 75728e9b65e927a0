from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.protocol.blob_cache import MAX_BLOBS, BlobCache
from hpccomponent.protocol.messages import Share


def share(number: int, size: int = 10) -> Share:
    return Share("s", number.to_bytes(16, "little"), b"", [size])


def key(number: int) -> bytes:
    return share(number).key


def test_the_least_recently_used_goes_first_and_what_is_needed_stays() -> None:
    cache = BlobCache(20)
    for number in range(4):
        assert cache.put(share(number))
    assert not cache.put(share(0))
    assert cache.use([key(0), key(9)]) == [key(9)]
    assert cache.is_full()
    assert cache.evict({key(1)}) == [key(2), key(3)]
    assert not cache.is_full()


def test_what_is_forgotten_goes_as_soon_as_nothing_needs_it() -> None:
    cache = BlobCache(1000)
    cache.put(share(1))
    cache.forget([key(1), key(2)])
    assert cache.evict({key(1)}) == []
    assert cache.is_full()
    assert cache.evict(set()) == [key(1)]
    assert not cache.is_full()


def test_a_blob_that_comes_again_is_no_longer_forgotten() -> None:
    cache = BlobCache(1000)
    cache.put(share(1))
    cache.forget([key(1)])
    cache.put(share(1))
    assert cache.evict(set()) == []


def test_the_worker_gets_each_blob_once_and_again_after_it_went() -> None:
    cache = BlobCache(0)
    cache.put(share(1))
    assert cache.hand_over([key(1)]) == [key(1)]
    assert cache.hand_over([key(1)]) == []
    assert cache.evict(set()) == [key(1)]
    cache.put(share(1))
    assert cache.hand_over([key(1)]) == [key(1)]
    cache.worker_has.clear()  # it died
    assert cache.hand_over([key(1)]) == [key(1)]


@given(
    st.lists(st.tuples(st.integers(0, MAX_BLOBS * 2), st.integers(0, 50)), max_size=60),
    st.sets(st.integers(0, 60)),
)
def test_the_limit_holds_but_for_what_is_needed(
    blobs: list[tuple[int, int]], needed: set[int]
) -> None:
    cache = BlobCache(100)
    sizes = {number: size for number, size in blobs if cache.put(share(number, size))}
    gone = cache.evict({key(number) for number in needed})
    kept = {number: size for number, size in sizes.items() if key(number) not in gone}
    assert needed & sizes.keys() <= kept.keys()
    assert sum(size for number, size in kept.items() if number not in needed) <= 100
