"""The kernel tests again, with the extension built under AddressSanitizer and UBSan."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[3]
INSIDE = "HPCAPP_SANITIZED"  # set in the run under the sanitizers, which must not start another

# Puts the sanitized extension in the place of the installed one, then runs the tests.
RUN = """
import importlib.util, sys, pytest
name = "hpcapp.kernels._native"
spec = importlib.util.spec_from_file_location(name, sys.argv[1])
module = importlib.util.module_from_spec(spec)
sys.modules[name] = module
spec.loader.exec_module(module)
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", *sys.argv[2:]]))
"""


def sanitizer_libraries(compiler: str) -> list[str]:
    """Name the run-time libraries, which must be loaded before Python itself."""
    found = []
    for name in ("libasan.so", "libubsan.so", "libstdc++.so"):
        line = subprocess.run(
            [compiler, f"-print-file-name={name}"], capture_output=True, text=True, check=True
        ).stdout.strip()
        if Path(line).is_absolute():
            found.append(line)
    return found


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_kernels_under_sanitizers(tmp_path: Path) -> None:
    if os.environ.get(INSIDE):
        pytest.skip("this is the run under the sanitizers")
    compiler, cmake = shutil.which("g++"), shutil.which("cmake")
    if compiler is None or cmake is None or find_spec("nanobind") is None:
        pytest.skip("needs g++, cmake and nanobind")
    libraries = sanitizer_libraries(compiler)
    if len(libraries) < 3:
        pytest.skip("the compiler comes without libasan and libubsan")
    source = ["-S", str(ROOT), "-B", str(tmp_path), f"-DPython_EXECUTABLE={sys.executable}"]
    configure = [cmake, *source, "-DHPC_SANITIZE=ON", f"-DCMAKE_CXX_COMPILER={compiler}"]
    build = [cmake, "--build", str(tmp_path), "--parallel", "2"]
    for command in (configure, build):
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    (extension,) = tmp_path.glob("_native*.so")
    tests = [
        str(HERE / f"test_{name}.py")
        for name in ("against_numpy", "bits", "hostile", "outliers", "seams", "views")
    ]
    environment = os.environ | {
        INSIDE: "1",
        "LD_PRELOAD": " ".join(libraries),
        # Python frees little at its end, and a refused allocation is one of the tests.
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1",
    }
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(extension), *tests],
        env=environment, cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-6000:]
