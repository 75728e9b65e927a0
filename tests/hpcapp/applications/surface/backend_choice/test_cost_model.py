from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.applications.surface.backend_choice.cost_model import (
    Choice,
    Here,
    Job,
    Link,
    There,
    choose,
    forecast_here,
    forecast_there,
    may_pay,
)

LOCAL, WORKERS = Choice("serial", 1, ""), Choice("zmq", 4, "4 workers")

seconds = st.floats(1e-5, 1.0)
jobs = st.builds(
    Job,
    st.integers(0, 10**10),
    st.integers(16, 4096),
    is_cut=st.booleans(),
    is_shared=st.booleans(),
)
heres = st.builds(Here, seconds, st.integers(1, 64))
links = st.builds(Link, st.floats(0.0, 1.0), st.floats(1e3, 1e11))
theres = st.builds(
    There,
    st.lists(seconds, min_size=1, max_size=20).map(tuple),
    links,
    st.floats(0.0, 60.0),
)
better = st.floats(1.0, 1e3)


def is_distributed(job: Job, here: Here, there: There) -> bool:
    return choose(job, here, there, LOCAL, WORKERS).backend == "zmq"


@given(jobs, heres, theres)
def test_workers_are_never_chosen_where_they_should_be_slower(
    job: Job, here: Here, there: There
) -> None:
    choice = choose(job, here, there, LOCAL, WORKERS)
    assert choice.local_s == forecast_here(job, here)
    assert choice.distributed_s == forecast_there(job, here, there)
    if choice.backend == "zmq":
        assert choice.distributed_s < choice.local_s
    assert choice.workers == (4 if choice.backend == "zmq" else 1)


@given(jobs, heres, links, st.integers(1, 20), st.floats(0.0, 1e4))
def test_who_is_not_measured_would_not_be_chosen(
    job: Job, here: Here, link: Link, workers: int, units: float
) -> None:
    there = There((here.unit_s,) * workers, link, units * here.unit_s)
    assert may_pay(job, here.threads, workers, units * 0.999) or not is_distributed(
        job, here, there
    )


@given(jobs, heres, theres, better)
def test_a_wider_link_never_turns_workers_away(
    job: Job, here: Here, there: There, factor: float
) -> None:
    wider = replace(there, link=replace(there.link, bytes_per_s=factor * there.link.bytes_per_s))
    assert is_distributed(job, here, wider) >= is_distributed(job, here, there)


@given(jobs, heres, theres, seconds)
def test_another_worker_never_turns_the_others_away(
    job: Job, here: Here, there: There, unit_s: float
) -> None:
    more = replace(there, unit_s=(*there.unit_s, unit_s))
    assert is_distributed(job, here, more) >= is_distributed(job, here, there)


@given(jobs, heres, theres, better)
def test_more_work_for_the_same_bytes_never_turns_workers_away(
    job: Job, here: Here, there: There, factor: float
) -> None:
    """Machines that are slower, all alike, have more work for each byte."""
    slower_here = replace(here, unit_s=factor * here.unit_s)
    slower = replace(there, unit_s=tuple(factor * unit_s for unit_s in there.unit_s))
    assert is_distributed(job, slower_here, slower) >= is_distributed(job, here, there)


@given(jobs, heres, links)
def test_no_workers_are_never_chosen(job: Job, here: Here, link: Link) -> None:
    assert not is_distributed(job, here, There((), link))


@pytest.mark.parametrize(
    ("job", "workers", "megabytes_per_s", "pays"),
    [
        (Job(1_000, 256), 16, 1e3, False),  # over before the workers are there
        (Job(10_000_000, 1024), 1, 1e3, False),  # one is no more than this one
        (Job(10_000_000, 1024), 16, 1.0, False),  # points take longer than the work
        (Job(10_000_000, 1024, is_cut=True, is_shared=True), 4, 1.0, True),  # they stay
    ],
)
def test_what_decides(job: Job, workers: int, megabytes_per_s: float, pays: bool) -> None:
    there = There((0.003,) * workers, Link(1e-3, 1e6 * megabytes_per_s), ready_s=0.5)
    assert is_distributed(job, Here(0.003), there) == pays


def test_the_reason_is_one_sentence_with_the_figures() -> None:
    there = There((0.003,) * 4, Link(1e-3, 1e8), ready_s=0.5)
    choice = choose(Job(1000, 64), Here(0.003), there, LOCAL, WORKERS)
    assert choice.reason.startswith("1000 points at grid 64 should take ")
    assert "with 4 workers" in choice.reason
    assert "MB/s" in choice.reason
    assert choice.reason.endswith("that does not pay")
    told = choice.to_json()
    assert told == json.loads(json.dumps(told, allow_nan=False))
    assert (told["backend"], told["workers"]) == ("serial", 1)
