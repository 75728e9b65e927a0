"""Files that the workers see, or do not."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from hpcapp.backends.selection import open_executor
from hpcapp.backends.serial import SerialExecutor
from hpcapp.workforce import Workforce
from hpccomponent.runtime.visible_files import sees_files


@pytest.mark.parametrize("name", ["serial", "processes", "zmq"])
def test_workers_of_this_machine_see_its_files(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # workers stand elsewhere
    Path("one").write_bytes(b"12345")
    Path("none").touch()
    workers = None if name == "serial" else 2
    with open_executor(name, workers=workers) as backend:
        assert backend.workforce.sees(Path("one"), Path("none"))


class Elsewhere(SerialExecutor):
    """Its last worker sees another file under the same name."""

    asked = 0

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.asked += 1
        files = [(path, length + (self.asked == 3)) for path, length in args]
        return super().submit(fn, *files)


def test_one_worker_that_sees_another_file_is_enough(tmp_path: Path) -> None:
    path = tmp_path / "points"
    path.write_bytes(b"12345")
    elsewhere = Elsewhere()
    assert not Workforce(elsewhere, 2).sees(path)
    assert elsewhere.asked == 4


def test_what_is_not_there_is_not_seen(tmp_path: Path) -> None:
    assert not sees_files((str(tmp_path / "none"), 0))
    with pytest.raises(OSError, match="none"):
        Workforce(SerialExecutor()).sees(tmp_path / "none")
