from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from hpcdeploy.jobs.tail import follow
from hpcdeploy.spec.job_folder import EXIT_CANCELLED, JobFolder, JobOrder, JobState, create_job


class Going(JobFolder):
    """The folder of a job that ends and is taken away between two looks at it."""

    looks = 0

    def is_alive(self) -> bool:
        self.looks += 1
        if self.looks == 4:  # each look at a job asks this too
            shutil.rmtree(self.path)
        return super().is_alive()


@pytest.mark.parametrize("state", [JobState.RUNNING, JobState.DONE])
def test_a_job_whose_cluster_is_taken_down_has_ended(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], state: JobState
) -> None:
    job, lock = create_job(tmp_path, JobOrder("reconstruct", "points.ply", "mesh.ply"))
    try:
        going = Going(job.path)
        job.write_status(replace(job.read_status(), state=state))
        follow(going)
    finally:
        os.close(lock)
    told = json.loads(capfd.readouterr().out.splitlines()[-1])["status"]
    if state is JobState.DONE:
        assert told["state"] == "done"
    else:
        assert (told["state"], told["exit_code"]) == ("cancelled", EXIT_CANCELLED)
        assert "taken down" in told["reason"]
