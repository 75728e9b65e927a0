"""A master on a cluster's inventory, with real loaders."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fixture_types import StartCommand
from standing import StartCluster

import hpcapp
from hpcapp.backends import cluster as cluster_module
from hpcapp.backends.selection import Backend
from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import NoWorkersError, UsageError
from hpccomponent.inventory import dump_inventory, read_inventory
from hpccomponent.protocol.keys import write_secret

TASK = "quadrature.estimate"


def submit(backend: Backend, right: float = 1.0) -> Future[FloatArray]:
    executor = backend.executor
    assert isinstance(executor, CommunicatorExecutor)
    return executor.submit(TASK, "wave", np.zeros(1), np.array([right]))


def estimate(backend: Backend) -> list[float]:
    estimates: list[float] = submit(backend).result(30).ravel().tolist()
    return estimates


@pytest.mark.slow
def test_a_cluster_is_an_executor(
    standing_cluster: StartCluster, caplog: pytest.LogCaptureFixture
) -> None:
    cluster = standing_cluster()
    with caplog.at_level("INFO"), hpcapp.open_executor(str(cluster.inventory)) as backend:
        assert backend.name == "cluster"
        assert backend.workforce.workers == 2
        first = estimate(backend)
        assert backend.traffic().bytes_sent > 0
    assert "cluster standing: 2 of 2 workers" in caplog.text
    with hpcapp.open_executor(str(cluster.inventory)) as backend:  # the workers come back
        assert estimate(backend) == first


def test_a_cluster_with_a_dead_machine_starts(
    standing_cluster: StartCluster,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(cluster_module, "OTHERS_WAIT_S", 0.1)
    cluster = standing_cluster(names=("head", "worker-1"), running=1)
    with hpcapp.open_executor(str(cluster.inventory)) as backend:
        assert backend.workforce.workers == 1
        estimate(backend)
    assert "1 of 2 workers" in caplog.text


def test_a_cluster_without_a_living_machine_does_not(
    standing_cluster: StartCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "FIRST_WAIT_S", 0.1)
    cluster = standing_cluster(running=0)
    with (
        pytest.raises(NoWorkersError, match="0 of 1 workers"),
        hpcapp.open_executor(str(cluster.inventory)),
    ):
        pass


def test_what_a_cluster_cannot_have_is_refused(standing_cluster: StartCluster) -> None:
    path = standing_cluster(running=0).inventory
    with (
        pytest.raises(UsageError, match="leave workers out"),
        hpcapp.open_executor(str(path), workers=2),
    ):
        pass
    write_secret(path, dump_inventory(replace(read_inventory(path), workers=())))
    with pytest.raises(UsageError, match="lists no worker"), hpcapp.open_executor(str(path)):
        pass


@pytest.mark.slow
def test_a_machine_that_joins_the_inventory_joins_the_job(
    standing_cluster: StartCluster,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(cluster_module, "WATCH_S", 0.05)
    cluster = standing_cluster(names=("head", "worker-1"))
    whole = read_inventory(cluster.inventory)
    first = replace(whole, workers=whole.workers[:1])
    write_secret(cluster.inventory, dump_inventory(first))
    with caplog.at_level("INFO"), hpcapp.open_executor(str(cluster.inventory)) as backend:
        assert backend.workforce.workers == 1
        write_secret(cluster.inventory, dump_inventory(whole))
        backend.executor.wait_for_workers(2, 30)  # type: ignore[attr-defined]
        write_secret(cluster.inventory, dump_inventory(first))
        while "shrank" not in caplog.text:
            estimate(backend)
    assert "cluster standing grew from 1 to 2 workers (worker-1)" in caplog.text
    assert "cluster standing shrank from 2 to 1 workers (worker-1)" in caplog.text


def test_masters_follow_one_another(standing_cluster: StartCluster) -> None:
    cluster = standing_cluster()
    with hpcapp.open_executor(str(cluster.inventory)):
        code = (
            "import sys, hpcapp, logging; logging.basicConfig(level='INFO', format='%(message)s')\n"
        )
        code += "with hpcapp.open_executor(sys.argv[1]): print('open')"
        second = subprocess.Popen(
            [sys.executable, "-P", "-c", code, str(cluster.inventory)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert second.stderr is not None
        assert second.stderr.readline() == "waiting for the cluster's present job to end\n"
    assert second.communicate(timeout=60)[0] == "open\n"


def test_nothing_heavy_is_imported_for_the_name() -> None:
    code = "import sys, hpcapp; print('numpy' in sys.modules, hasattr(hpcapp, 'no_such_thing'))"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert done.stdout == "False False\n"


@pytest.fixture
def run_command(start_command: StartCommand) -> Callable[..., tuple[int, str, str]]:
    def run(*arguments: str) -> tuple[int, str, str]:
        process = start_command(*arguments)
        output, errors = process.communicate(timeout=120)
        return process.returncode, output, errors

    return run


def test_a_job_on_a_cluster_gives_the_bytes_of_a_local_one(
    standing_cluster: StartCluster,
    run_command: Callable[..., tuple[int, str, str]],
    sphere_file: Path,
    tmp_path: Path,
) -> None:
    cluster = standing_cluster()
    options = ("--grid", "32", "--json")
    code, _, errors = run_command("reconstruct", str(sphere_file), "-o", "local.ply", *options)
    assert code == 0, errors
    code, output, errors = run_command(
        "reconstruct", str(sphere_file), "-o", "remote.ply", *options,
        "--cluster", str(cluster.inventory), "--backend", "zmq", "--events", "events.jsonl",
    )  # fmt: skip
    assert code == 0, errors
    assert (tmp_path / "remote.ply").read_bytes() == (tmp_path / "local.ply").read_bytes()
    report = json.loads(output)
    assert (report["backend"], report["workers"]) == ("cluster", 2)
    events = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert {"stage": "read", "done": 0, "total": 0} in events
    assert {event["stage"] for event in events if "seconds" in event} == set(report["stages"])


def test_a_killed_component_costs_no_job(standing_cluster: StartCluster, tmp_path: Path) -> None:
    cluster = standing_cluster()
    with hpcapp.open_executor(str(cluster.inventory)) as backend:
        futures = [submit(backend, number) for number in range(50)]
        os.kill(cluster.components()[0], signal.SIGKILL)
        assert len([future.result(60) for future in futures]) == 50
