from __future__ import annotations

from hpcapp.communicator.scheduling.forecast import Forecast
from hpcapp.communicator.scheduling.speculation import choose_to_speculate, choose_to_split
from hpcapp.communicator.scheduling.state import OpenBatch, Task, Worker
from hpccomponent.protocol.messages import PROTOCOL_VERSION, Register


def worker(name: str, *tasks: Task) -> Worker:
    register = Register(PROTOCOL_VERSION, "1", name, "i", "b", "n", 1, 1, 1 << 20)
    made = Worker(name.encode(), register, "", 0.0)
    if tasks:
        made.batches[1] = OpenBatch({task.number: task for task in tasks})
        for task in tasks:
            task.holders[made.identity] = 1
    return made


def task(number: int, work: float = 1.0, can_split: bool = False) -> Task:
    return Task(number, "t", 10, (), work, can_split)


def taught(**seconds: float) -> Forecast:
    forecast = Forecast()
    for name, unit_s in seconds.items():
        forecast.learn(name.encode(), task(0), unit_s)
    return forecast


def test_the_longest_task_is_split_while_too_few_wait() -> None:
    workers = [worker("a"), worker("b"), worker("c")]
    short, long, whole = task(1, 1.0, True), task(2, 3.0, True), task(3, 9.0)
    forecast = taught(a=1.0)
    assert choose_to_split([short, long], workers, forecast, 0.0) is long
    assert choose_to_split([short, long, whole], workers, forecast, 0.0) is None
    assert choose_to_split([whole], workers, forecast, 0.0) is None
    assert choose_to_split([task(4, 0.1, True)], workers, forecast, 0.0) is None
    assert choose_to_split([long], workers, Forecast(), 0.0) is None
    busy = [worker("a", task(7, 50.0)), worker("b", task(8, 50.0)), worker("c")]
    assert choose_to_split([long], busy, forecast, 0.0) is None


def test_an_idle_worker_gets_what_would_be_done_last() -> None:
    first, last = task(1), task(2)
    slow, idle = worker("slow", first, last), worker("idle")
    forecast = taught(slow=4.0, idle=1.0)
    assert choose_to_speculate([slow, idle], [idle], forecast, 0.0) == [(idle, last)]
    assert choose_to_speculate([slow, idle], [], forecast, 0.0) == []


def test_what_is_nearly_done_twice_at_work_or_dangerous_is_left_alone() -> None:
    idle, other = worker("idle"), worker("other")
    forecast = taught(slow=1.0, idle=1.0, other=1.0)
    for spoil in ("is_done", "losses", "holders", "time"):
        lagging = task(1)
        slow = worker("slow", lagging)
        if spoil == "is_done":
            lagging.is_done = True
        elif spoil == "losses":
            lagging.losses["m"] = 1
        elif spoil == "holders":
            lagging.holders[b"other"] = 2
        now = 0.5 if spoil == "time" else 5.0
        assert choose_to_speculate([slow, idle, other], [idle], forecast, now) == []
    assert choose_to_speculate([worker("slow", task(1))], [idle], forecast, 5.0)


def test_what_may_be_on_its_way_as_long_as_others_were_is_left_alone() -> None:
    forecast = Forecast()
    forecast.learn(b"idle", task(0), 1.0, transit_s=2.0)
    slow, idle = worker("slow", task(1)), worker("idle")
    assert choose_to_speculate([slow, idle], [idle], forecast, 4.5) == []
    assert choose_to_speculate([slow, idle], [idle], forecast, 5.0)
