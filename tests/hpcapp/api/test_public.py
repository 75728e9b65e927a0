"""What ``import hpcapp`` promises: public names, quick imports, examples that run."""

from __future__ import annotations

import doctest
import inspect
import pickle
import re
import subprocess
import sys

import pytest

import hpcapp


@pytest.mark.parametrize("name", hpcapp.__all__)
def test_a_public_name_says_that_it_is_hpcapps(name: str) -> None:
    public = getattr(hpcapp, name)
    assert (public.__module__, public.__qualname__) == ("hpcapp", name)
    assert pickle.loads(pickle.dumps(public)) is public  # noqa: S301 - our own


@pytest.mark.parametrize("name", hpcapp.__all__)
def test_a_public_name_is_documented_and_its_examples_run(name: str) -> None:
    public = getattr(hpcapp, name)
    texts = [public.__doc__]
    if isinstance(public, type):
        methods = [m for n, m in vars(public).items() if n[0] != "_" and inspect.isfunction(m)]
        texts += [method.__doc__ for method in methods]
    for text in texts:
        assert text
        test = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
        if test.examples:
            assert name in text[text.index(">>>") :]
            assert doctest.DocTestRunner().run(test).failed == 0


def test_errors_have_their_public_names_in_tracebacks_from_the_first_call_on() -> None:
    code = "import hpcapp; hpcapp.read_points('no-such-file.ply')"
    found = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert re.search(r"^hpcapp\.InputError: no-such-file\.ply", found.stderr, re.MULTILINE)


def test_what_is_listed_is_the_interface() -> None:
    code = "import hpcapp; print(*dir(hpcapp)); hpcapp.Mesh; print(*dir(hpcapp))"
    listed = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert listed.splitlines() == [" ".join(sorted(hpcapp.__all__))] * 2


def test_importing_the_package_imports_nothing_heavy() -> None:
    code = (
        "import sys, hpcapp; print(dir(hpcapp)); "
        "sys.exit(bool({'numpy', 'zmq', 'click', 'hpccomponent'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert "'reconstruct'" in found.stdout
    with pytest.raises(AttributeError, match="no attribute 'reconstrukt'"):
        getattr(hpcapp, "reconstrukt")  # noqa: B009 - mypy knows that it is not there


def test_the_interface_needs_no_optional_package() -> None:
    code = (
        "import sys, hpcapp; [getattr(hpcapp, name) for name in hpcapp.__all__]; "
        "sys.exit(bool({'trimesh', 'open3d', 'pyvista', 'matplotlib'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-P", "-c", code]).returncode == 0
