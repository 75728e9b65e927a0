"""The wheel of this very release: made of the files that run here, so that it cannot be another.

No compiler and no build tool is needed: the Python files and the compiled extension of the
running installation are packed, and without the extension they are the portable build.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
import zipfile
from collections.abc import Iterator
from importlib.metadata import Distribution, distribution
from importlib.util import find_spec
from pathlib import Path

from hpccomponent.errors import CloudError

DISTRIBUTION = "hpcapp"
_PACKAGES = ("hpcapp", "hpccomponent", "hpcdeploy", "hpcloader")
_LEFT_OUT = {".pyc", ".so", ".cpp", ".h"}
_BUILD_TAG = re.compile(r"^Tag: (\w+)-(\w+)-linux_(\w+)$", re.M)


def pack_release(folder: Path, *, is_native: bool) -> Path | None:
    """Pack the running installation into a wheel; the same content makes the same bytes.

    The wheel is put into `folder`. With `is_native` it has the compiled extension, and is None
    where the installation has none. Raises CloudError where its files cannot be read.
    """
    installed = distribution(DISTRIBUTION)
    try:
        extensions = dict(_extensions(installed)) if is_native else {}
        tag = _native_tag(installed, extensions) if extensions else "py3-none-any"
        if is_native and not extensions:
            return None
        files = {**dict(_modules()), **extensions}
        folder.mkdir(parents=True, exist_ok=True)
        return _write_wheel(folder, installed, tag, files)
    except OSError as error:
        raise CloudError(
            f"{error.filename}: the installed hpcapp cannot be packed ({error.strerror})",
            "install it again, or name a wheel as env.package",
        ) from error


def _modules() -> Iterator[tuple[str, bytes]]:
    """Yield the name in the wheel and the content of each file that is no extension."""
    for package in _PACKAGES:
        spec = find_spec(package)
        for place in (spec.submodule_search_locations or ()) if spec is not None else ():
            for path in sorted(Path(place).rglob("*")):
                if path.is_file() and path.suffix not in _LEFT_OUT:
                    yield f"{package}/{path.relative_to(place).as_posix()}", path.read_bytes()


def _extensions(installed: Distribution) -> Iterator[tuple[str, bytes]]:
    for file in installed.files or ():
        if file.suffix == ".so" and file.parts[0] in _PACKAGES:
            yield file.as_posix(), Path(str(installed.locate_file(file))).read_bytes()


def _native_tag(installed: Distribution, extensions: dict[str, bytes]) -> str:
    """Return the build's tag, with the oldest C library that its extension runs on."""
    match = _BUILD_TAG.search(installed.read_text("WHEEL") or "")
    if match is None:  # a wheel from an index says it already
        return (installed.read_text("WHEEL") or "").partition("Tag: ")[2].split()[0]
    needed = [
        int(minor)
        for content in extensions.values()
        for minor in re.findall(rb"GLIBC_2\.(\d+)", content)
    ]
    return f"{match[1]}-{match[2]}-manylinux_2_{max([17, *needed])}_{match[3]}"


def _write_wheel(folder: Path, installed: Distribution, tag: str, files: dict[str, bytes]) -> Path:
    meta = f"{DISTRIBUTION}-{installed.version}.dist-info"
    wheel = f"Wheel-Version: 1.0\nGenerator: hpcapp\nRoot-Is-Purelib: false\nTag: {tag}\n"
    entries = {
        **files,
        f"{meta}/METADATA": (installed.read_text("METADATA") or "").encode(),
        f"{meta}/entry_points.txt": (installed.read_text("entry_points.txt") or "").encode(),
        f"{meta}/WHEEL": wheel.encode(),
    }
    record = "".join(
        f"{name},{_digest(content)},{len(content)}\n" for name, content in entries.items()
    )
    entries[f"{meta}/RECORD"] = f"{record}{meta}/RECORD,,\n".encode()
    target = folder / f"{DISTRIBUTION}-{installed.version}-{tag}.whl"
    beside = target.with_name(f".{target.name}.{os.getpid()}")
    with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(_entry(name), content)
    os.replace(beside, target)
    return target


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)  # of the same date always
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = 0o644 << 16
    return entry


def _digest(content: bytes) -> str:
    digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest())
    return f"sha256={digest.decode().rstrip('=')}"
