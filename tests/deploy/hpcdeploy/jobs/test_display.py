"""Displays of a job: a page on the head becomes one of this machine."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from hpccomponent.foreign_json import decode
from hpcdeploy.jobs.display import ForwardingDisplay, JobDisplay, JobEvent


class Shown(JobDisplay):
    def __init__(self) -> None:
        self.said: list[Any] = []

    def show_log(self, line: str) -> None:
        self.said.append(line)

    def show_event(self, event: JobEvent) -> None:
        self.said.append(event)


def test_the_port_changes_and_the_token_stays(caplog: pytest.LogCaptureFixture) -> None:
    shown = Shown()
    asked: list[int] = []

    def forward(port: int) -> int:
        asked.append(port)
        return 4321

    display = ForwardingDisplay(shown, forward)
    assert not display.has_page
    stage = JobEvent("fit", 1, 2)
    with caplog.at_level(logging.INFO, "hpcapp"):
        display.show_event(JobEvent(dashboard="http://127.0.0.1:1234/?token=a-b_c"))
    display.show_event(stage)
    display.show_log("a line")
    assert asked == [1234]
    assert caplog.messages == ["dashboard: http://127.0.0.1:4321/?token=a-b_c"]
    assert display.has_page
    assert shown.said == [stage, "a line"]


@pytest.mark.parametrize("host", ["127.0.0.1", "[::1]", "[a", "a]", "[", "::", "[1]", "x:1:y"])
@pytest.mark.parametrize("port", [1, 80, 9999, 10000, 59999, 64999, 65499, 65529, 65535])
def test_whatever_host_a_head_names_its_page_is_led_to_by_one_way(host: str, port: int) -> None:
    asked: list[int] = []

    def forward(port: int) -> int:
        asked.append(port)
        return 4321

    display = ForwardingDisplay(Shown(), forward)
    event = decode(f'{{"dashboard": "http://{host}:{port}/?token=a"}}', JobEvent)
    display.show_event(event)
    display.show_event(event)
    assert asked == [port]
