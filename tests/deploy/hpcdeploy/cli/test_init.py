"""What `init` writes is valid, and what it leaves alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from typed import run

from hpcdeploy.cli.init import PROVIDERS


@pytest.mark.parametrize("provider", PROVIDERS)
def test_what_is_written_is_valid_and_has_comments(provider: str, tmp_path: Path) -> None:
    file = tmp_path / "lab.yaml"
    assert run("init", file, "--provider", provider) == 0
    assert file.read_text().startswith("# ")
    assert run("validate", file) == 0
    assert run("plan", file, "--offline") == 0


def test_without_a_name_it_is_cluster_yaml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("init") == 0
    assert "type: aws" in Path("cluster.yaml").read_text()
    assert "hpcapp plan cluster.yaml" in capsys.readouterr().out


def test_no_file_is_replaced_unasked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text("mine")
    assert run("init", file) == 2
    assert file.read_text() == "mine"
    assert "is there already" in capsys.readouterr().err
    assert run("init", file, "--force") == 0
    assert file.read_text() != "mine"


def test_a_place_that_cannot_be_written_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("init", tmp_path / "no" / "lab.yaml") == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
