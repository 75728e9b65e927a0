"""Hosts of a cluster file that do not let us see: told apart in every verb, and never ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from machines.openssh import open_sshd
from machines.rude import ACTS, open_rude
from machines.servers import USER, Server

from hpcapp.cli import hpcapp
from hpccomponent.errors import CloudError, HpcError
from hpccomponent.runtime.numerics import package_version
from hpcdeploy.login.parallel import run_parallel
from hpcdeploy.providers import ssh_hosts
from hpcdeploy.reconcile.cluster import open_cluster


def write_hosts(file: Path, hosts: list[dict[str, Any]], **more: Any) -> None:
    spec = json.loads(file.read_text())
    file.write_text(json.dumps(spec | {"provider": {"type": "ssh", "hosts": hosts}} | more))


def host(server: Server) -> dict[str, Any]:
    return {"address": server.address, "port": server.port, "user": USER}


def run(*words: object) -> str:
    """Run a verb; return all that it says."""
    result = CliRunner().invoke(hpcapp, [str(word) for word in words])
    assert result.exception is None or isinstance(result.exception, HpcError | SystemExit)
    return result.output + str(result.exception or "")


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ssh_hosts, "LOOK_S", 1.0)


@pytest.fixture
def silent_port() -> Iterator[int]:
    with open_rude(ACTS["silent"]) as port:
        yield port


@pytest.mark.slow
@pytest.mark.usefixtures("impatient")
def test_each_verb_tells_the_causes_apart(
    file: Path,
    hosts: tuple[Server, Server],
    silent_port: int,
    tmp_path: Path,
) -> None:
    rude = {"address": "127.0.0.1", "port": silent_port, "user": USER}
    locked = tmp_path / "user/.ssh/locked"
    subprocess.run(
        ["ssh-keygen", "-q", "-t", "ed25519", "-N", "sesame", "-f", str(locked)], check=True
    )
    config = f"Host needy\n  HostName 127.0.0.1\n  IdentityFile {locked}\n"
    (tmp_path / "user/.ssh/config").write_text(config)
    with open_rude(ACTS["shut"]) as gone:
        pass
    with open_rude(ACTS["web"]) as web:
        others = [
            rude,
            rude | {"port": web},
            rude | {"port": gone},
            host(hosts[1]) | {"user": "stranger"},
            {"address": "needy"},
        ]
        write_hosts(file, [host(hosts[0]), *others], workers={"count": 5, "min": 0})
        causes = {
            "worker-1": "does not answer",
            "worker-2": "does not speak SSH",
            "worker-3": "unreachable",
            "worker-4": "refuses our key",
            "worker-5": "passphrase needed",
        }
        for verb in ("plan", "status", "doctor"):
            said = run(verb, file)
            for node, cause in causes.items():
                line = next(
                    (line for line in said.splitlines() if node in line and cause in line), ""
                )
                assert line, (verb, node, said)
            assert "terminate" not in said
            assert "Traceback" not in said
        said = run("ls", file)
        assert all(cause in said for cause in causes.values()), said


def test_a_plan_of_hosts_that_refuse_says_so_in_a_line_each_and_by_its_exit_code(
    file: Path, hosts: tuple[Server, Server], tmp_path: Path
) -> None:
    """A real sshd under two names: of one the host key is known, and our key is not let in."""
    folder = tmp_path / "sshd"
    folder.mkdir()
    with open_rude(ACTS["shut"]) as gone:
        pass
    with open_sshd(folder) as target:
        kind, key = (folder / "host.pub").read_text().split()[:2]
        with (tmp_path / "user/.ssh/known_hosts").open("a") as known:
            known.write(f"[127.0.0.1]:{target.port} {kind} {key}\n")
        there = {"port": target.port, "user": target.user}
        closed = {"address": "127.0.0.1", "port": gone, "user": USER}
        refusing = [there | {"address": "127.0.0.1"}, there | {"address": "localhost"}, closed]
        write_hosts(file, [host(hosts[0]), *refusing])
        done = CliRunner().invoke(hpcapp, ["plan", str(file)], standalone_mode=False)
    lines = [line for line in done.output.splitlines() if "cannot be looked at" in line]
    assert [line.split(" (")[0] for line in lines] == ["worker-1", "worker-2", "worker-3"]
    for line, cause in zip(
        lines, ("refuses our key", "host key unknown", "unreachable"), strict=True
    ):
        assert f"cannot be looked at: {cause}" in line
    assert "would launch head" in done.output
    assert isinstance(done.exception, CloudError)
    assert done.exception.exit_code == 4
    assert "3 of 4 hosts cannot be looked at: worker-1, worker-2, worker-3" in str(done.exception)


@pytest.mark.usefixtures("hosts")
@pytest.mark.parametrize("verb", ["plan", "up", "status", "doctor"])
def test_a_key_with_a_passphrase_is_told_before_any_host_is_asked(
    verb: str, file: Path, tmp_path: Path
) -> None:
    locked = tmp_path / "locked"
    subprocess.run(
        ["ssh-keygen", "-q", "-t", "ed25519", "-N", "sesame", "-f", str(locked)], check=True
    )
    spec = json.loads(file.read_text())
    file.write_text(json.dumps(spec | {"auth": {"ssh_private_key": str(locked)}}))
    said = run(verb, file, *(["-y"] if verb == "up" else []))
    assert f"passphrase needed: the private key {locked}" in said
    assert f"run ssh-add {locked}" in said
    assert "terminate" not in said


@pytest.mark.slow
@pytest.mark.usefixtures("impatient")
def test_of_three_hosts_the_one_that_never_opens_ssh_is_done_without(
    file: Path,
    hosts: tuple[Server, Server],
    silent_port: int,
    wheelhouse: Path,
) -> None:
    (file.parent / "wheels").rmdir()
    (file.parent / "wheels").symlink_to(wheelhouse)
    rude = {"address": "127.0.0.1", "port": silent_port, "user": USER}
    write_hosts(file, [host(hosts[0]), host(hosts[1]), rude], workers={"count": 2, "min": 1})
    said = run("up", file, "-y")
    assert "going without worker-2: does not answer" in said
    assert "terminat" not in said
    told = run("status", file)
    [worker] = [line for line in told.splitlines() if line.startswith("worker-1")]
    assert "running" in worker
    assert package_version() in worker  # its loader
    with open_cluster(file) as cluster:
        cluster.provider.terminate(cluster.machines())


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("verb", [["up"], ["scale", "1"]], ids=lambda verb: verb[0])
@pytest.mark.parametrize("cause", ["unreachable", "does not answer"])
def test_nothing_is_put_on_workers_whose_head_cannot_be_looked_at(
    file: Path, hosts: tuple[Server, Server], silent_port: int, verb: list[str], cause: str
) -> None:
    with open_rude(ACTS["shut"]) as gone:
        pass
    port = silent_port if cause == "does not answer" else gone
    head = {"address": "127.0.0.1", "port": port, "user": USER}
    write_hosts(file, [head, host(hosts[1])], env={})
    words = [verb[0], str(file), *verb[1:], "-y", "--skip-checks"]
    done = CliRunner().invoke(hpcapp, words, standalone_mode=False)
    assert isinstance(done.exception, CloudError)
    assert done.exception.exit_code == 4
    said = str(done.exception)
    assert said.startswith(f"head cannot be had: {cause}: ")
    assert f"127.0.0.1:{port}" in said
    assert said.endswith(f"; it stays as it is; look at hpcapp doctor {file}")
    assert not [*hosts[1].home.iterdir()]
    assert "taking away" not in done.output


MANY = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_NOFILE, (128, 128))
from hpcdeploy.reconcile.cluster import open_cluster
with open_cluster(Path(sys.argv[1])) as cluster:
    seen = cluster.provider.observe(None).machines
print(len(seen), *sorted({m.reason.partition(":")[0] for m in seen}), sep="|")
"""


def test_1200_hosts_are_looked_at_under_a_low_limit_of_descriptors(
    file: Path, hosts: tuple[Server, Server]
) -> None:
    del hosts
    with open_rude(ACTS["web"], "0.0.0.0") as port:  # noqa: S104 - all addresses of loopback
        places = [f"127.1.{n // 200}.{n % 200 + 1}" for n in range(1200)]
        write_hosts(file, [{"address": place, "port": port} for place in places])
        done = subprocess.run(
            [sys.executable, "-P", "-c", MANY, str(file)],
            capture_output=True,
            text=True,
            check=False,
        )
    assert (done.stdout.strip(), done.stderr) == ("1200|does not speak SSH", "")


def test_ctrl_c_while_connecting_ends_at_once_and_says_one_line(
    file: Path, hosts: tuple[Server, Server]
) -> None:
    del hosts
    connected = threading.Event()

    def act(client: Any, is_over: threading.Event) -> None:
        connected.set()
        is_over.wait()

    with open_rude(act) as port:
        write_hosts(file, [{"address": "127.0.0.1", "port": port, "user": USER}])
        with subprocess.Popen(
            [sys.executable, "-P", "-m", "hpcapp", "status", str(file)],
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert connected.wait(60)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    waiting = "ending; a second signal (Ctrl-C) ends at once"  # said where the end takes a while
    lines = [line for line in said.splitlines() if line not in ("", waiting)]
    assert lines == ["hpcapp: interrupted"]


def test_an_interrupt_leaves_calls_that_hang_behind_and_begins_no_further() -> None:
    begun: list[int] = []
    is_over, is_begun = threading.Event(), threading.Event()

    def call(number: int) -> None:
        begun.append(number)
        if len(begun) == 3:
            is_begun.set()
        is_over.wait()

    def interrupt() -> None:
        is_begun.wait()
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        run_parallel(call, range(1000), 3, "test")
    thread.join()
    is_over.set()
    assert sorted(begun) == [0, 1, 2]


def test_results_come_in_the_order_of_the_items() -> None:
    double: Callable[[int], int] = lambda number: 2 * number  # noqa: E731
    assert run_parallel(double, range(50), 7, "test") == list(range(0, 100, 2))
    assert run_parallel(double, [], 7, "test") == []
