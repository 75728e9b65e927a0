"""What is missing on a host is known to `doctor`, and stops `up` before it changes anything."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from machines.hosts import claim
from machines.servers import Server
from typed import run

from hpccomponent.errors import CloudError
from hpcdeploy.cli.doctor import doctor
from hpcdeploy.install.bootstrap import set_up
from hpcdeploy.reconcile.cluster import open_cluster
from hpcdeploy.reconcile.converge import look_ahead
from hpcdeploy.reconcile.examination import visit
from hpcdeploy.reconcile.preflight import check_ready

OLD = "3.9 True"
BARE = "3.11 False"


def give_python(host: Server, said: str, programs: Path, free_kib: int = 1 << 24) -> None:
    """Let a host have all programs of this machine, but another Python and another disk."""
    programs.mkdir()
    for folder in ("/usr/bin", "/bin"):
        for path in Path(folder).iterdir():
            if not path.name.startswith(("python", "df")) and not (programs / path.name).exists():
                (programs / path.name).symlink_to(path)
    write_program(programs / "python3", f"echo {said}")
    write_program(programs / "df", f"echo; echo tmpfs 1 1 {free_kib} 1% /home")
    host.path = str(programs)


def write_program(path: Path, text: str) -> None:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def change(file: Path, **changes: object) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("give", "line"),
    [
        (lambda host, to: give_python(host, OLD, to), "found: 3.9 (python3)"),
        (lambda host, to: give_python(host, BARE, to), "found: 3.11 (python3, without venv)"),
        (lambda host, to: give_python(host, "3.11 True", to, 2048), "its disk has 2 MiB left"),
    ],
    ids=["old", "no-venv", "disk"],
)
def test_a_host_that_cannot_be_set_up_is_named_and_stops_up(
    file: Path,
    hosts: tuple[Server, Server],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    give: Callable[[Server, Path], None],
    line: str,
) -> None:
    change(file, env={})
    give(hosts[1], tmp_path / "programs")
    told = CliRunner().invoke(doctor, [str(file)])
    assert isinstance(told.exception, CloudError)
    assert line in told.output
    assert "head: good (Python 3." in told.output
    assert run("up", "-y", file) == 4
    said = capsys.readouterr().err.splitlines()[-1]
    assert "nothing is launched: worker-1: " in said
    assert line in said
    assert not [host for host in hosts if (host.home / "hpcapp").exists()]


TALKS = "echo 'activating the module environment'; echo; "
QUIET = "printf 'no line end'; "


@pytest.mark.parametrize("before", [TALKS, QUIET], ids=["lines", "no-line-end"])
def test_what_a_wrapper_of_python_prints_besides_is_no_answer(
    file: Path, hosts: tuple[Server, Server], tmp_path: Path, before: str
) -> None:
    change(file, env={})
    give_python(hosts[1], OLD, tmp_path / "programs")
    write_program(
        tmp_path / "programs/python3", f'{before}{sys.executable} "$@"; echo 1.2 is no answer'
    )
    with open_cluster(file) as cluster:
        seen = visit(cluster, cluster.provider.hosts())[1]
    assert seen.problems == ()
    assert seen.about.startswith(f"Python {sys.version_info[0]}.{sys.version_info[1]}")


def test_wheels_that_are_missing_for_a_hosts_own_python_stop_up(
    file: Path, hosts: tuple[Server, Server], capsys: pytest.CaptureFixture[str]
) -> None:
    (file.parent / "wheels/other-2.0-cp39-cp39-manylinux_2_17_x86_64.whl").touch()
    told = CliRunner().invoke(doctor, [str(file)])
    mine = f"Python {sys.version_info[0]}.{sys.version_info[1]}"
    assert f"for {mine}" in told.output
    assert run("up", "-y", file) == 4
    assert "nothing is launched" in capsys.readouterr().err
    assert not [host for host in hosts if (host.home / "hpcapp").exists()]


def test_a_worker_that_cannot_be_set_up_is_done_without_where_the_file_allows_it(
    file: Path, hosts: tuple[Server, Server], tmp_path: Path
) -> None:
    change(file, env={}, workers={"min": 0})
    give_python(hosts[1], OLD, tmp_path / "programs")
    said: list[str] = []
    with open_cluster(file) as cluster:
        check_ready(cluster, look_ahead(cluster).actions, [], said.append)
        hosts[0].path = hosts[1].path
        with pytest.raises(CloudError, match=r"nothing is launched: head: no Python"):
            check_ready(cluster, look_ahead(cluster).actions, [], said.append)
    assert said[0].startswith("problem: worker-1: no Python >=3.11")


def test_the_users_commands_may_install_python(
    file: Path, hosts: tuple[Server, Server], tmp_path: Path
) -> None:
    programs = tmp_path / "programs"
    give_python(hosts[1], OLD, programs)
    command = (
        f"printf '#!/bin/sh\\necho 3.11 True\\n' >{programs}/python3; echo once >>{tmp_path}/ran"
    )
    change(file, env={"wheelhouse": "wheels", "setup": [command]})
    with open_cluster(file) as cluster:
        claim(cluster)
        _, worker = cluster.machines()
        failures = set_up(cluster.spec, cluster.machines(), cluster.access, print)
    assert "the wheelhouse has no" in failures[worker.id], "its Python was found"
    assert (tmp_path / "ran").read_text() == "once\n"


def test_a_host_that_lets_us_in_and_hangs_is_given_up_in_time(
    file: Path, hosts: tuple[Server, Server], tmp_path: Path
) -> None:
    give_python(hosts[1], OLD, tmp_path / "programs")
    uname = tmp_path / "programs/uname"
    uname.unlink()
    write_program(uname, "exec sleep 1000")
    with open_cluster(file) as cluster:
        head, worker = visit(cluster, cluster.provider.hosts(), wait_s=20, answer_s=20)
    assert "did not end within 20 s" in worker.problems[0].what
    assert "did not end" not in " ".join(problem.what for problem in head.problems)


def test_a_state_folder_that_cannot_be_written_is_found(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a-file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "a-file"))
    told = CliRunner().invoke(doctor, [str(file)])
    assert f"state folder: {tmp_path / 'a-file'}: cannot be written; set XDG_STATE" in told.output
