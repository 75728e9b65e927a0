"""Tests of real scans: skipped where these are not at hand, which in CI is an error."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HELPERS = Path(__file__).with_name("helpers")


@pytest.mark.parametrize(("ci", "outcome"), [("true", "1 failed"), ("", "1 skipped")])
def test_scans_that_are_not_at_hand_are_an_error_in_ci_alone(
    tmp_path: Path, ci: str, outcome: str
) -> None:
    test = "from shared_data import shared\ndef test_a():\n    shared('scan.ply')\n"
    (tmp_path / "test_a.py").write_text(test)
    variables = {"CI": ci, "HPCAPP_DATA": str(tmp_path), "PYTHONPATH": str(HELPERS)}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider", "--rootdir", tmp_path],
        cwd=tmp_path,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert outcome in done.stdout
    assert f"{tmp_path}/scan.ply is not there: let HPCAPP_DATA name" in done.stdout
