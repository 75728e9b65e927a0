"""Meshes that show themselves."""

from __future__ import annotations

import html
import shutil
import tempfile
import webbrowser
from pathlib import Path

import numpy as np
import pytest

import hpcapp
from hpcapp.applications.surface.types.points import PointCloud

CORNERS = np.array([[0.0, 0, 0], [2.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_a_notebook_gets_a_frame_with_the_page() -> None:
    shown = hpcapp.Mesh(CORNERS, FACES)._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    page = html.unescape(shown.split('"')[1])
    assert page.startswith("<!DOCTYPE html>")
    assert "4 vertices, 4 faces" in page


def test_show_opens_the_page_that_it_has_written(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []

    def open_browser(uri: str) -> bool:
        opened.append(uri)
        return True

    monkeypatch.setattr(webbrowser, "open", open_browser)
    path = hpcapp.Mesh(CORNERS, FACES).show(PointCloud(CORNERS))
    assert opened == [path.as_uri()]
    assert path.is_relative_to(temporary)
    assert 'id="show-points"' in path.read_text()
    shutil.rmtree(path.parent)


def test_a_machine_without_a_browser_gets_the_path(
    temporary: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    path = hpcapp.Mesh(CORNERS, FACES).show()
    assert str(path) in caplog.text


def test_what_is_read_and_what_is_reconstructed_can_be_shown(tmp_path: Path) -> None:
    hpcapp.Mesh(CORNERS, FACES).save(tmp_path / "a.ply")
    read = hpcapp.read_mesh(tmp_path / "a.ply")
    assert isinstance(read, hpcapp.Mesh)
    np.testing.assert_array_equal(read.faces, FACES)
    normals = np.random.default_rng(0).normal(size=(2000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert isinstance(hpcapp.reconstruct(normals, normals, grid=16), hpcapp.Mesh)
