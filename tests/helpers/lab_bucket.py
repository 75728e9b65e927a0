"""A bucket behind a real S3 endpoint: a plugin of the tests that name it.

They use `endpoint` for the whole module, so that it is there before a test's leaks are looked for.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from typing import Protocol

import boto3
import pytest
from moto.server import ThreadedMotoServer

from hpccomponent.store.places import hold_store


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Make the environment one in which boto3 finds these credentials and no others."""
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    for name in ("CONFIG", "SHARED_CREDENTIALS"):
        monkeypatch.setenv(f"AWS_{name}_FILE", "/dev/null")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIA")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    return monkeypatch


class Item(Protocol):
    """An object in a bucket."""

    key: str


class Items(Protocol):
    """What is in a bucket."""

    def all(self) -> Iterable[Item]: ...


class Bucket(Protocol):
    """As much of boto3's bucket as tests use."""

    objects: Items

    def put_object(self, *, Key: str, Body: bytes) -> object: ...  # noqa: N803

    def create(self) -> object: ...

    def delete(self) -> object: ...


@pytest.fixture
def bucket(endpoint: str, keys: pytest.MonkeyPatch) -> Iterator[Bucket]:
    keys.setenv("AWS_ENDPOINT_URL", endpoint)
    resource = boto3.resource("s3")
    lab = resource.create_bucket(Bucket="lab")
    yield lab
    hold_store.cache_clear()  # the next test has other keys, or another endpoint
    lab.objects.all().delete()
    lab.delete()
    resource.meta.client.close()
