"""The journal: intents and outcomes, torn lines, one owner at a time."""

from __future__ import annotations

import fcntl
import json
import os
import pwd
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from hpccomponent.errors import CapacityError, CloudError, OutputError
from hpcdeploy.ownership.journal import Attempt, Journal, open_journal, peek_journal
from hpcdeploy.provider import LaunchChoice
from hpcdeploy.spec.layout import clusters_folder, forget_cluster, state_folder
from hpcdeploy.spec.names import NodeName

UNTIL = datetime(2026, 11, 1, 14, tzinfo=UTC)
LAUNCH: dict[str, str | int] = {
    "incarnation": "life",
    "node": "worker-1",
    "generation": 1,
    "instance_type": "c6i.xlarge",
    "market": "spot",
    "lease_until": UNTIL.isoformat(),
}


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def cut_short(journal: Journal) -> None:
    with pytest.raises(KeyboardInterrupt), journal.step("launch worker-1", **LAUNCH):
        raise KeyboardInterrupt


def test_what_is_done_or_refused_is_finished_and_what_has_failed_is_not() -> None:
    with open_journal("bunny") as journal:
        with journal.step("create the group"):
            pass
        with pytest.raises(CapacityError), journal.step("launch worker-1"):
            raise CapacityError("none to be had")
        with pytest.raises(CloudError), journal.step("create the key pair"):
            raise CloudError("the answer is lost")
    with open_journal("bunny") as journal:
        assert journal.unfinished() == ["create the key pair"]
        with journal.step("create the key pair"):
            pass
        assert journal.unfinished() == []


def test_a_command_that_is_done_finishes_what_was_begun_before_it() -> None:
    with open_journal("bunny") as journal:
        cut_short(journal)
        with pytest.raises(CloudError), journal.command("bring the cluster up"):
            raise CloudError("no answer")
        assert journal.unfinished() == ["launch worker-1", "bring the cluster up"]
        with journal.command("bring the cluster up"):
            with journal.step("create the group"):
                pass
            with pytest.raises(CloudError), journal.step("launch worker-2"):
                raise CloudError("the answer is lost")
    with open_journal("bunny") as journal:
        assert journal.unfinished() == ["launch worker-2"]


def test_what_was_cut_short_is_told_to_the_next_command() -> None:
    with open_journal("bunny") as journal:
        cut_short(journal)
    with open_journal("bunny") as journal:
        assert journal.unfinished() == ["launch worker-1"]
        expected = Attempt(LaunchChoice("c6i.xlarge", "spot"), UNTIL)
        assert journal.attempt("life", NodeName("worker-1")) == expected
        assert journal.attempt("life", NodeName("worker-1", 2)) is None
        assert journal.attempt("another life", NodeName("worker-1")) is None


def test_a_launch_that_is_done_is_asked_for_again_in_the_same_words() -> None:
    with open_journal("bunny") as journal:
        with journal.step("launch worker-1", **LAUNCH):
            pass
        expected = Attempt(LaunchChoice("c6i.xlarge", "spot"), UNTIL)
        assert journal.attempt("life", NodeName("worker-1")) == expected


@pytest.mark.parametrize(
    ("error", "may_have_come_about"),
    [(CapacityError("none"), False), (CloudError("the answer is lost"), True)],
)
def test_only_a_refusal_settles_an_attempt(error: CloudError, may_have_come_about: bool) -> None:
    with open_journal("bunny") as journal:
        with pytest.raises(CloudError), journal.step("launch worker-1", **LAUNCH):
            raise error
        assert (journal.attempt("life", NodeName("worker-1")) is not None) == may_have_come_about


def test_every_intent_is_on_the_disk_before_the_step_is_taken() -> None:
    with open_journal("bunny") as journal, journal.step("launch worker-1", **LAUNCH):
        lines = (state_folder("bunny") / "journal.jsonl").read_text().splitlines()
        assert json.loads(lines[-1])["intent"] == "launch worker-1"


@pytest.mark.parametrize("length", range(1, 40, 6))
def test_a_torn_last_line_is_left_out(length: int) -> None:
    with open_journal("bunny") as journal:
        cut_short(journal)
    path = state_folder("bunny") / "journal.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole + whole[:length])
    with open_journal("bunny") as journal:
        assert journal.unfinished() == ["launch worker-1"]
        journal.note_bad("i-1", "no pip")
    with open_journal("bunny") as journal:
        assert journal.known_bad == {"i-1"}


def test_what_a_machine_says_makes_no_journal_unreadable() -> None:
    words = "head: no Linux system with a shell (it says " + "x" * 70_000
    path = state_folder("bunny") / "journal.jsonl"
    with open_journal("bunny") as journal:
        journal.note_bad("i-1", words)
        for error in (CloudError(words), CapacityError(words)):
            with pytest.raises(CloudError), journal.step("set up worker-1"):
                raise error
    assert path.stat().st_size < 10_000
    path.write_text(path.read_text() + json.dumps({"bad": "i-2", "why": words}) + "\n")
    with open_journal("bunny") as journal:  # an earlier release wrote all of it
        assert journal.known_bad == {"i-1", "i-2"}


def test_a_damaged_line_is_named() -> None:
    path = state_folder("bunny") / "journal.jsonl"
    path.parent.mkdir(parents=True)
    path.write_text("{}\nnonsense\n{}\n")
    with pytest.raises(CloudError, match=r"journal\.jsonl:2: not a line of the journal; move"):
        open_journal("bunny").__enter__()


def test_a_second_command_is_refused_while_the_first_is_at_work() -> None:
    with (
        open_journal("bunny"),
        open_journal("another"),
        pytest.raises(CloudError, match="bunny is being changed by another hpcapp"),
    ):
        open_journal("bunny").__enter__()


def test_a_forgotten_cluster_leaves_no_folder() -> None:
    folder = state_folder("bunny")
    with open_journal("bunny") as journal:
        journal.note_bad("i-1", "no pip")
        (folder / "keys.json").touch()
        (folder / ".id.4711").touch()
        (folder / "nodes").mkdir()
        (folder / "release").mkdir()
        (folder / "release/hpcapp-1.0-py3-none-any.whl").touch()
        forget_cluster("bunny")
    assert not clusters_folder().parent.exists(), "nor those that it was in"
    with open_journal("bunny") as journal:
        assert journal.known_bad == frozenset()
        (folder / "theirs").touch()
        forget_cluster("bunny")
    assert list(folder.iterdir()) == [folder / "theirs"]


def test_a_journal_that_was_removed_while_it_was_waited_for_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lock = fcntl.flock

    def forget_first(file: Any, operation: int) -> None:
        forget_cluster("bunny")
        lock(file, operation)

    monkeypatch.setattr(fcntl, "flock", forget_first)
    with pytest.raises(CloudError, match="being changed by another hpcapp"):
        open_journal("bunny").__enter__()


def test_a_state_folder_that_cannot_be_made_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with pytest.raises(OutputError, match="Not a directory; set XDG_STATE_HOME"):
        open_journal("bunny").__enter__()


@pytest.mark.parametrize(("state", "home"), [("", ""), ("relative", "")])
def test_an_empty_home_is_none_and_a_relative_state_folder_is_ignored(
    monkeypatch: pytest.MonkeyPatch, state: str, home: str
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", state)
    monkeypatch.setenv("HOME", home)
    own = pwd.getpwuid(os.getuid()).pw_dir
    assert clusters_folder() == Path(own) / ".local/state/hpcapp/clusters"


LIES: list[Any] = [
    7,
    None,
    [],
    {"bad": ["i-1"]},
    {"set up": "i-1"},
    {"set up": [1]},
    {"place": {}},
    {"incarnation": 1},
    {"generation": "1"},
    {"generation": -1},
    {"is_command": 1},
    {"intent": None},
]


@pytest.mark.parametrize("lie", [*map(json.dumps, LIES), '{"bad": NaN}', "[" * 100_000, "\udcff"])
def test_a_line_that_is_none_is_named_once(lie: str) -> None:
    path = state_folder("bunny") / "journal.jsonl"
    path.parent.mkdir(parents=True)
    text = f'{{"incarnation": "life"}}\n{lie}\n'.encode(errors="surrogateescape")
    path.write_bytes(text)
    assert peek_journal("bunny").lives == {"life"}
    with (
        pytest.raises(CloudError, match=r"journal\.jsonl:2: not a line of the journal") as caught,
        open_journal("bunny"),
    ):
        pass
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == text


def test_lines_that_are_incomplete_say_nothing() -> None:
    path = state_folder("bunny") / "journal.jsonl"
    path.parent.mkdir(parents=True)
    entries: list[dict[str, Any]] = [
        {"cleared": "a place that was never made"},
        {"intent": "launch", "key": "abc"},
        {"incarnation": "life", "node": "worker-1", "generation": 1},
        {**LAUNCH, "lease_until": "2026-99-99"},
        {**LAUNCH, "lease_until": "2026-11-01"},
    ]
    path.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    with open_journal("bunny") as journal:
        assert journal.places == ()
        assert journal.launched() == frozenset()
        assert journal.attempt("life", NodeName("worker-1")) is None
