"""`hpcapp.open_executor` with a cluster file, over a real OpenSSH server, from elsewhere."""

from __future__ import annotations

import getpass
import json
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np
import pytest
from heads import install_python
from machines.hosts import claim
from machines.openssh import start_sshd
from standing import StartCluster

from hpcapp import open_executor
from hpcapp.geometry.points import FloatArray
from hpcapp.lab.quadrature.application import estimate
from hpccomponent.errors import CloudError
from hpcdeploy.reconcile.cluster import open_cluster


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """The head's home, with what `up` installs there."""
    home = tmp_path / "head"
    install_python(home / "hpcapp/lab")
    return home


@pytest.fixture
def cluster_file(tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cluster file with one host, that the user's ssh knows."""
    server, port = start_sshd(tmp_path, home)
    monkeypatch.setenv("HOME", str(tmp_path / "user"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "user/.ssh").mkdir(parents=True)
    key = " ".join((tmp_path / "host.pub").read_text().split()[:2])
    (tmp_path / "user/.ssh/known_hosts").write_text(f"[127.0.0.1]:{port} {key}\n")
    host = {"address": "127.0.0.1", "port": port, "user": getpass.getuser()}
    path = tmp_path / "lab.yaml"
    spec = {
        "version": 1,
        "cluster": "lab",
        "provider": {"type": "ssh", "hosts": [host]},
        "auth": {"ssh_private_key": str(tmp_path / "login")},
    }
    path.write_text(json.dumps(spec))
    yield path
    server.terminate()
    server.communicate()


def submit(executor: Executor, right: float) -> Future[FloatArray]:
    arguments = "wave", np.zeros(1), np.array([right])
    future: Future[FloatArray] = executor.submit("quadrature.estimate", *arguments)  # type: ignore[arg-type]
    return future


def test_a_program_elsewhere_has_the_workers_of_a_cluster_file(
    cluster_file: Path, home: Path, standing_cluster: StartCluster
) -> None:
    standing_cluster(home / "hpcapp/lab")
    with open_cluster(cluster_file) as cluster:
        claim(cluster)
    with open_executor(str(cluster_file)) as backend:
        assert (backend.name, backend.workforce.workers) == ("cluster", 2)
        results = [f.result(60).tolist() for f in [submit(backend.executor, r) for r in range(20)]]
        assert backend.traffic().bytes_received > 0
    local = [estimate("wave", np.zeros(1), np.array([float(r)])).tolist() for r in range(20)]
    assert results == local


def test_a_cluster_file_that_is_not_up_is_one_line(cluster_file: Path) -> None:
    with (
        pytest.raises(CloudError, match=r"cluster lab is not up; run hpcapp up .*lab\.yaml"),
        open_executor(str(cluster_file)),
    ):
        pass
