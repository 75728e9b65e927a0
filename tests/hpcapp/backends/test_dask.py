"""Dask, by a real scheduler and real workers."""

from __future__ import annotations

import asyncio
import datetime
import ipaddress
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from standing import StartDask

import hpcapp
from hpcapp.backends.selection import open_backend, open_executor
from hpcapp.geometry.points import PointCloud
from hpcapp.kernels.build import kernel_id
from hpcapp.workforce import map_batches
from hpccomponent.errors import JobError, NoWorkersError, TaskError, UsageError, WorkerLostError

if TYPE_CHECKING:
    from distributed import Client

dask = pytest.importorskip("dask", reason="Dask is not installed")
distributed = pytest.importorskip("distributed", reason="Dask is not installed")
engine = pytest.importorskip("hpcapp.backends.dask", reason="Dask is not installed")

# The cluster stands for all tests here, and a client keeps a thread for messages.
pytestmark = pytest.mark.leaks_allowed


@pytest.fixture(scope="module")
def address(start_dask: StartDask) -> str:
    return str(start_dask().address)


@pytest.fixture
def client(address: str) -> Iterator[Client]:
    with distributed.Client(address, set_as_default=False) as client:
        yield client


@pytest.mark.slow
def test_the_command_gives_the_same_bytes(
    address: str,
    sphere_file: Path,
    tmp_path: Path,
    start_command: Callable[..., subprocess.Popen[str]],
) -> None:
    for name, backend in (("dask.ply", f"dask={address}"), ("here.ply", "serial")):
        command = start_command(
            "reconstruct", str(sphere_file), "-o", name, "--grid", "32", "--backend", backend
        )
        _, said = command.communicate()
        assert command.returncode == 0, said
        assert "distributed" not in said
    assert (tmp_path / "dask.ply").read_bytes() == (tmp_path / "here.ply").read_bytes()


def test_a_client_is_used_and_stays_open(client: Client, sphere: PointCloud) -> None:
    assert sphere.normals is not None
    alone = hpcapp.reconstruct(sphere.positions, sphere.normals, grid=32)
    mesh = hpcapp.reconstruct(sphere.positions, sphere.normals, grid=32, executor=client)
    assert mesh.vertices.tobytes() == alone.vertices.tobytes()
    assert mesh.faces.tobytes() == alone.faces.tobytes()
    assert client.submit(pow, 2, 3).result() == 8


def test_the_workers_are_counted_by_their_threads(client: Client) -> None:
    client.wait_for_workers(2)
    with open_backend(client) as backend:
        assert (backend.name, backend.workforce.workers) == ("Client", 2)


def test_what_a_task_raises_is_the_tasks(client: Client, tasks: ModuleType) -> None:
    with open_backend(client) as backend, pytest.raises(TaskError, match="ValueError: no luck"):
        map_batches(backend.workforce, tasks.fail, [("no luck",)])


def test_a_shared_value_is_sent_once_and_comes_to_every_task(
    client: Client, tasks: ModuleType
) -> None:
    value = np.random.default_rng(1).standard_normal((700_000, 3))  # Dask warns from 10 MB on
    with open_backend(client) as backend:
        shared: Any = backend.workforce.share(value)
        again: Any = backend.workforce.share(value.copy())
        assert shared is not value
        assert again.key == shared.key
        batches = [(number, ("nested", shared)) for number in range(4)]
        for number, (word, found) in map_batches(backend.workforce, tasks.echo, batches):
            assert word == "nested"
            assert number in range(4)
            assert found.tobytes() == value.tobytes()


def test_tasks_of_a_killed_worker_run_on_the_other(
    start_dask: StartDask, tasks: ModuleType, tmp_path: Path
) -> None:
    cluster = start_dask()
    with open_executor(f"dask={cluster.address}") as backend:
        released = str(tmp_path / "released")
        started = [str(tmp_path / name) for name in ("one", "two")]
        value = np.arange(100_000.0)
        futures = [
            backend.executor.submit(tasks.announce_and_wait, name, released) for name in started
        ]
        shared = backend.workforce.share(value)
        later = [backend.executor.submit(tasks.total, shared) for _ in range(8)]
        for name in started:
            tasks.wait_for_file(name)
        cluster.workers[0].kill()
        Path(released).touch()
        assert {future.result(60) for future in futures} == {cluster.workers[1].pid}
        assert {future.result(60) for future in later} == {tasks.total(value)}


def test_a_mesh_survives_the_death_of_a_worker(start_dask: StartDask, sphere: PointCloud) -> None:
    assert sphere.normals is not None
    alone = hpcapp.reconstruct(sphere.positions, sphere.normals, grid=32)
    cluster = start_dask()
    with distributed.Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(2)

        def kill_one(stage: str, done: int, total: int) -> None:
            if 0 < done < total:
                os.kill(cluster.workers[0].pid, signal.SIGKILL)

        mesh = hpcapp.reconstruct(
            sphere.positions, sphere.normals, grid=32, executor=client, on_progress=kill_one
        )
    assert cluster.workers[0].wait() == -signal.SIGKILL
    assert mesh.vertices.tobytes() == alone.vertices.tobytes()
    assert mesh.faces.tobytes() == alone.faces.tobytes()


def test_the_job_fails_with_its_scheduler(
    start_dask: StartDask, tasks: ModuleType, tmp_path: Path
) -> None:
    cluster = start_dask(workers=1)
    started, never = str(tmp_path / "started"), str(tmp_path / "never")
    with open_executor(f"dask={cluster.address}") as backend:
        future = backend.executor.submit(tasks.announce_and_wait, started, never)
        tasks.wait_for_file(started)
        cluster.scheduler.kill()
        with pytest.raises(WorkerLostError, match="its engine gave it up; look at the logs"):
            future.result(60)


def test_a_worker_of_another_build_refuses_and_says_why(start_dask: StartDask) -> None:
    other = "native" if kernel_id().startswith("portable") else "portable"
    cluster = start_dask(workers=1, variables={"HPCAPP_BUILD": other})
    with (
        open_executor(f"dask={cluster.address}") as backend,
        pytest.raises(JobError, match=f"computes with {other}-.*; install the same build"),
    ):
        map_batches(backend.workforce, pow, [(2, 3)])


def test_a_task_that_kills_its_workers_is_counted_by_their_deaths() -> None:
    error = distributed.scheduler.KilledWorker("task", None, 3)
    assert engine.count_deaths(error) == 4
    assert engine.count_deaths(ValueError()) == 0


def test_a_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "CONNECT_S", 0.2)
    with (
        pytest.raises(NoWorkersError, match=r"no Dask scheduler answers at tcp://127.0.0.1:9 "),
        open_executor("dask=tcp://127.0.0.1:9"),
    ):
        pass


def test_a_scheduler_without_workers_is_named(
    start_dask: StartDask, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "WORKERS_S", 0.2)
    with (
        pytest.raises(NoWorkersError, match=r"has no workers; start some with 'dask worker"),
        open_executor(f"dask={start_dask(workers=0).address}"),
    ):
        pass


def test_tls_without_certificates_is_refused() -> None:
    with (
        pytest.raises(UsageError, match=r"names no certificates; set distributed.comm.tls"),
        open_executor("dask=tls://127.0.0.1:9"),
    ):
        pass


def test_a_client_for_coroutines_is_refused(address: str, sphere: PointCloud) -> None:
    normals = sphere.normals
    assert normals is not None

    async def reconstruct() -> None:
        async with distributed.Client(address, asynchronous=True, set_as_default=False) as client:
            hpcapp.reconstruct(sphere.positions, normals, executor=client)

    with pytest.raises(UsageError, match="this Dask Client is asynchronous"):
        asyncio.run(reconstruct())


def make_certificate(folder: Path) -> dict[str, str]:
    """Write a key and a certificate that signs itself; return Dask's settings that name them."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "hpcapp test")])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]),
            critical=False,
        )
        .sign(key, hashes.SHA256())
    )
    (folder / "key.pem").write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    (folder / "cert.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    settings = {"ca-file": str(folder / "cert.pem")}
    for role in ("scheduler", "worker", "client"):
        settings[f"{role}.key"] = str(folder / "key.pem")
        settings[f"{role}.cert"] = str(folder / "cert.pem")
    return settings


def test_tls_by_dasks_own_configuration(start_dask: StartDask, tmp_path: Path) -> None:
    settings = make_certificate(tmp_path)
    variables = {
        "DASK_DISTRIBUTED__COMM__TLS__" + name.replace(".", "__").replace("-", "_").upper(): value
        for name, value in settings.items()
    }
    cluster = start_dask(variables=variables)
    assert cluster.address.startswith("tls://")
    with (
        dask.config.set(
            {f"distributed.comm.tls.{name}": value for name, value in settings.items()}
        ),
        open_executor(f"dask={cluster.address}") as backend,
    ):
        assert map_batches(backend.workforce, pow, [(2, 3), (2, 4)]) == [8, 16]
