"""The commands of the pages are run, and what they print is held against the pages."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[2] / "docs" / "run_commands.py"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("run_commands", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def page(folder: Path, commands: str, output: str) -> str:
    path = folder / "page.md"
    path.write_text(f"```sh\n{commands}\n```\n```output\n{output}\n```\n```sh\ntrue\n```\n")
    return str(path)


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        ("echo b; echo a", "a\nb"),
        ("echo b; echo a", "a"),
        ("echo on 2026-11-27 11:10", "on 2026-01-01 00:00"),
        ("echo at 2026-11-27T11:10:16", "at 2026-01-01T00:00:00"),
        ("echo '10s   1h05  0.02 s'", "9s 4m05 1.30 s"),
        ("pwd", "/home/me"),
    ],
)  # fmt: skip
def test_a_true_page_is_fine(script: ModuleType, tmp_path: Path, command: str, shown: str) -> None:
    assert script.main([page(tmp_path, command, shown)]) == 0


@pytest.mark.parametrize(
    ("command", "shown"),
    [("echo a", "b"), ("echo 3 workers", "4 workers"), ("echo a; false", "a"), ("true", "echo")],
)
def test_a_page_that_is_not_true_is_told(
    script: ModuleType, tmp_path: Path, command: str, shown: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert script.main([page(tmp_path, command, shown)]) == 1
    assert ("not printed: " in capfd.readouterr().out) == ("false" not in command)


@pytest.mark.slow
def test_a_page_that_leaves_a_cluster_is_told_and_the_cluster_is_taken_down(
    script: ModuleType,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    state = tmp_path / "state"
    monkeypatch.setattr(script, "CLUSTERS", str(state / "hpcapp/clusters"))
    monkeypatch.setenv("XDG_STATE_HOME", str(state))
    file = "{version: 1, cluster: left, provider: {type: local}, workers: {count: 0}}"
    up = f"echo '{file}' >left.yaml; hpcapp up -y left.yaml"
    assert script.main([page(tmp_path, up, "cluster left is up: 1 machines")]) == 1
    assert "1 cluster was left behind" in capfd.readouterr().out
    assert not list((state / "hpcapp/clusters").glob("*/nodes"))
