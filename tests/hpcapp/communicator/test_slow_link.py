"""A large result over a link that is slower than the patience of the master."""

from __future__ import annotations

import dataclasses
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from fixture_types import StartComponent

from hpcapp.communicator.executor import CommunicatorExecutor

WAIT = 120.0
PACE = 500_000.0  # bytes per second, from the component to the master


class SlowLink:
    """A way to the master for one component, which passes on so many bytes per second."""

    def __init__(self, endpoint: str) -> None:
        host, port = endpoint.removeprefix("tcp://").rsplit(":", 1)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp://127.0.0.1:{self._listening.getsockname()[1]}"
        self._address = host, int(port)
        self._is_over = threading.Event()
        self._threads = [threading.Thread(target=self._pass_up)]
        self._threads[0].start()

    def _pass_up(self) -> None:
        component, _ = self._listening.accept()
        # Not before: of a connection without a word the master is patient for half a minute.
        self._master = socket.create_connection(self._address)
        back = threading.Thread(target=self._pass_down, args=[component])
        self._threads.append(back)
        back.start()
        begin, passed = time.monotonic(), 0
        with component:
            while content := component.recv(16_384):
                try:
                    self._master.sendall(content)
                except OSError:
                    assert self._is_over.is_set()
                    return
                passed += len(content)
                if self._is_over.wait(max(0.0, begin + passed / PACE - time.monotonic())):
                    return

    def _pass_down(self, component: socket.socket) -> None:
        try:
            while content := self._master.recv(65_536):
                component.sendall(content)
        except OSError:
            return

    def close(self) -> None:
        self._is_over.set()
        self._master.shutdown(socket.SHUT_RDWR)
        for thread in list(self._threads):
            thread.join()
        self._master.close()
        self._listening.close()


@pytest.fixture
def link(executor: CommunicatorExecutor) -> Iterator[SlowLink]:
    link = SlowLink(executor.endpoint)
    yield link
    link.close()


@pytest.mark.slow
def test_a_slow_link_loses_no_worker_while_a_large_result_comes(
    executor: CommunicatorExecutor, start_component: StartComponent, link: SlowLink
) -> None:
    connection = executor.invite("far")
    start_component("far", dataclasses.replace(connection, endpoint=link.endpoint))
    executor.wait_for_workers(1, WAIT)
    values = np.arange(500_000.0)  # 8 s on the way, and the master waits 5 s for a word
    assert np.array_equal(executor.submit("contract.echo", values).result(WAIT), values)
    assert executor.statistics()["losses"] == 0
