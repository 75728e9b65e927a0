"""The loader's command line: one clear line and exit code 2 for every mistake."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hpcloader.__main__ import main

NEEDS_MUCH = """
version: 1
builds:
  - {name: huge, command: [x], requires: {min_cores: 100000}}
"""


def run_program(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", *words],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
    )


def test_facts_are_shown_with_the_chosen_build(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["facts"]) == 0
    rows = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert int(rows["cores"]) >= 1
    build, command = rows["build"].split(": ")
    assert build in ("native", "portable")
    assert command == f"{sys.executable} -P -m hpccomponent"


def test_facts_come_as_json_with_the_reasons(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    catalogue = tmp_path / "builds.yaml"
    catalogue.write_text(NEEDS_MUCH + "  - {name: small, command: ['{python}', x]}\n")
    assert main(["facts", "--json", "--catalogue", str(catalogue)]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["machine"]["memory"] > 0
    assert facts["build"] == "small"
    assert facts["command"] == [sys.executable, "x"]
    [passed_over] = facts["passed_over"]
    assert passed_over["build"] == "huge"
    assert "needed 100000" in passed_over["reason"]


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "loader.yaml: the file is empty"),
        ("version: 1\nname: m1", "loader.yaml:1:1: connection: missing key"),
        (
            "version: 1\nname: m1\nconnection: c.json\nrestart:\n  frist_s: 2",
            'loader.yaml:5:3: restart.frist_s: unknown key, did you mean "first_s"?',
        ),
        (
            "version: 1\nname: m1\nconnection: c.json\ntasks: [a.b]",
            "loader.yaml:4:9: tasks[0]: ",
        ),
        ("version: 1\nname: m1\nconnection: none.json", "loader.yaml: connection: no file"),
        (
            "version: 1\nname: m1\nconnection: c.json\ncatalogue: b.yaml",
            "no worker build of the catalogue fits this machine: huge (cores: ",
        ),
    ],
)
def test_a_wrong_file_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, part: str
) -> None:
    (tmp_path / "loader.yaml").write_text(text)
    (tmp_path / "c.json").write_text("{}")
    (tmp_path / "b.yaml").write_text(NEEDS_MUCH)
    assert main(["run", "--config", str(tmp_path / "loader.yaml")]) == 2
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert complaint.startswith("hpcloader: ")
    assert part in complaint


def test_a_connection_file_alone_does_and_is_looked_for(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["run", "--connection", str(tmp_path / "none.json")]) == 2
    complaint = capsys.readouterr().err
    assert complaint.startswith(f"hpcloader: {tmp_path}/none.json: no such file")
    (tmp_path / "c.json").write_text("{}")  # the component's mistake to name: no restart helps
    run = run_program("-m", "hpcloader", "run", "--connection", "c.json", cwd=tmp_path)
    assert run.returncode == 2
    assert f"loader {tmp_path.name}: build " in run.stderr


def test_without_files_of_people_what_reads_them_is_not_imported() -> None:
    run = run_program("-X", "importtime", "-m", "hpcloader", "facts")
    assert run.returncode == 0
    imported = {line.rpartition("|")[2].strip() for line in run.stderr.splitlines()}
    assert "hpcloader.builds" in imported
    assert not imported & {"yaml", "pydantic", "numpy", "zmq"}


def test_the_module_runs_as_a_program() -> None:
    run = run_program("-m", "hpcloader", "run", "--config", "/no/loader.yaml")
    assert run.returncode == 2
    assert run.stderr.startswith("hpcloader: /no/loader.yaml: cannot be read")
    assert run.stdout == ""
