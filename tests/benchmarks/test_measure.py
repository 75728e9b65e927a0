"""What is measured again, and what a table says of where it comes from."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import measure
import pytest
import tables
from measure import Result

pytestmark = pytest.mark.skipif(
    tables.ask_git("rev-parse", "--is-shallow-repository") != "false",
    reason="no whole history of git is here",
)
Keep = Callable[[str, str], Result]


@pytest.fixture
def keep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Keep:
    """Return what puts a result of a commit into the table."""
    monkeypatch.setattr(measure, "RESULTS", tmp_path)
    monkeypatch.setattr(measure, "TABLE", ())

    def put(name: str, commit: str) -> Result:
        result = Result(name, "tables.py", (), 1)
        if commit:
            result.path.write_text(json.dumps({"commit": commit}), encoding="utf-8")
        monkeypatch.setattr(measure, "TABLE", (*measure.TABLE, result))
        return result

    return put


def find_commit(back: str) -> str:
    commit = tables.ask_git("rev-parse", back)
    assert commit is not None
    return commit


def test_missing_old_and_unknown_results_are_due(keep: Keep) -> None:
    build = tables.find_build()
    assert build is not None
    new, young = keep("new", build), keep("young", find_commit("HEAD~10"))
    due = [keep("missing", ""), keep("old", find_commit("HEAD~400")), keep("lost", "before 0.2")]
    assert measure.choose([], build, takes_all=False) == due
    assert measure.choose([], build, takes_all=True) == [young, *due]
    assert measure.choose(["new"], build, takes_all=False) == [new]
    told = [measure.describe(result, build) for result in measure.TABLE]
    for line, word in zip(
        told, ("this build", "", "missing", "old", "no such commit"), strict=True
    ):
        assert word in line
    with pytest.raises(SystemExit, match="no result is called teapot"):
        measure.choose(["teapot"], build, takes_all=False)


def test_what_is_missing_is_said_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = Result("pots", "tables.py", ("no_such_module",), 1)
    assert not measure.measure(result, tmp_path)
    assert capsys.readouterr().out == "pots: left as it is, for want of no_such_module\n"


def test_a_script_that_fails_leaves_its_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], keep: Keep
) -> None:
    keep("pots", "before 0.2")
    assert not measure.measure(Result("pots", "decisions.py teapot", (), 1), tmp_path)
    assert "teapot" in (tmp_path / "pots/log").read_text(encoding="utf-8")
    assert "failed" in capsys.readouterr().out
    assert json.loads((tmp_path / "pots.json").read_text())["commit"] == "before 0.2"


def test_a_table_names_its_build_and_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.json"
    monkeypatch.setattr("sys.argv", ["/x/peers.py", "cost", "-o", str(path), "--repeats", "3"])
    tables.write_table(path, "Pots", ("a", "b"), [["c", 1.0]])
    table = json.loads(path.read_text(encoding="utf-8"))
    assert table["command"] == "python benchmarks/peers.py cost --repeats 3"
    assert table["commit"] == tables.find_build()
    assert tables.count_age(table["commit"]) is not None
    assert [file.name for file in tmp_path.iterdir()] == ["a.json"]
