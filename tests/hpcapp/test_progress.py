from __future__ import annotations

import pytest

from hpcapp.progress import Progress, ProgressObserver, StageClock


def test_a_stage_that_comes_twice_counts_as_one() -> None:
    clock = StageClock(Progress())
    for name in ("fit", "check", "fit"):
        with clock.stage(name):
            clock.progress.advance(1, 2)
    assert list(clock.seconds) == ["fit", "check"]
    assert min(clock.seconds.values()) >= 0.0


def test_a_stage_that_fails_does_not_end_well() -> None:
    class Recorder(ProgressObserver):
        def on_end(self, stage: str, seconds: float) -> None:
            ended.append(stage)

    ended: list[str] = []
    clock = StageClock(Progress(Recorder()))
    with pytest.raises(ValueError, match="no"), clock.stage("fit"):
        raise ValueError("no")
    assert ended == []
    assert clock.seconds == {}
