"""Values as objects of an S3-compatible bucket; see `store`.

Keys, region and endpoint are found where boto3 looks for them: the environment, the files in
``~/.aws``, the machine's role.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import boto3
from boto3.exceptions import Boto3Error
from botocore.config import Config
from botocore.exceptions import BotoCoreError, ClientError, NoCredentialsError

from hpccomponent.errors import CloudError, JobError, UsageError
from hpccomponent.files.checksum import note_written
from hpccomponent.store.base import check_name
from hpccomponent.store.value import DamagedError, from_bytes, to_buffers

_MISSING = ("404", "NoSuchKey", "NotFound")
_CONNECT_S, _READ_S = 10.0, 60.0


class S3Store:
    """Values as objects (see `Store`) behind a prefix of names: no ``/`` at its end, or empty."""

    def __init__(self, client: Any, bucket: str, prefix: str) -> None:
        self._client = client
        self._bucket = bucket
        self._prefix = f"{prefix}/" if prefix else ""

    def put(self, name: str, value: Any, *, replaces: bool = True) -> None:
        """See `Store.put`."""
        where = self._where(name)
        buffers = to_buffers(value, name)
        note_written(*buffers)
        if replaces or not self.has(name):
            with self._translated():
                self._client.put_object(**where, Body=b"".join(buffers))

    def get(self, name: str) -> Any:
        """See `Store.get`."""
        where = self._where(name)
        with self._translated():
            try:
                content = self._client.get_object(**where)["Body"].read()
            except ClientError as error:
                if _code(error) not in _MISSING:
                    raise
                raise JobError(f"{self._url(name)} is not there", "run the job again") from None
        try:
            return from_bytes(memoryview(content), name)
        except DamagedError as error:
            advice = "delete it, and run the job again"
            raise JobError(f"{self._url(name)} {error}", advice) from error

    def has(self, name: str) -> bool:
        """See `Store.has`."""
        where = self._where(name)
        with self._translated():
            try:
                self._client.head_object(**where)
            except ClientError as error:
                if _code(error) not in _MISSING:
                    raise
                return False
        return True

    def list(self, prefix: str = "") -> list[str]:
        """See `Store.list`."""
        with self._translated():
            pages = self._client.get_paginator("list_objects_v2").paginate(
                Bucket=self._bucket, Prefix=self._prefix + prefix
            )
            keys = [item["Key"] for page in pages for item in page.get("Contents", ())]
        return sorted(key.removeprefix(self._prefix) for key in keys)

    def delete(self, name: str) -> None:
        """See `Store.delete`."""
        where = self._where(name)
        with self._translated():
            self._client.delete_object(**where)

    def check(self) -> None:
        """Raise CloudError where there is no such bucket for us."""
        with self._translated():
            try:
                self._client.head_bucket(Bucket=self._bucket)
            except ClientError as error:
                if _code(error) not in _MISSING:
                    raise
                advice = "create it, or name another one"
                raise CloudError(f"there is no bucket {self._bucket!r}", advice) from None

    def _where(self, name: str) -> dict[str, str]:
        check_name(name)
        return {"Bucket": self._bucket, "Key": self._prefix + name}

    def _url(self, name: str) -> str:
        return f"s3://{self._bucket}/{self._prefix}{name}"

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Turn what boto3 raises into one line."""
        try:
            yield
        except NoCredentialsError as error:
            raise CloudError(
                f"s3://{self._bucket}: there are no credentials",
                "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE",
            ) from error
        except ClientError as error:
            raise CloudError(
                f"s3://{self._bucket}: {error.operation_name} was refused ({_code(error)})",
                "check the bucket's name and the rights of the credentials",
            ) from error
        except (Boto3Error, BotoCoreError) as error:
            raise CloudError(
                f"s3://{self._bucket}: {error}", "check AWS_ENDPOINT_URL and the network"
            ) from error


def open_s3_store(url: str) -> S3Store:
    """Open a bucket as a store.

    Raise UsageError where the address names no bucket, CloudError where the bucket is not there, or
    there are no credentials for it.
    """
    bucket, _, prefix = url.removeprefix("s3:").lstrip("/").partition("/")
    if not bucket:
        raise UsageError(f"{url!r} names no bucket", "write s3://BUCKET/PREFIX")
    config = Config(
        retries={"mode": "standard", "total_max_attempts": 4},
        s3={"addressing_style": "path"},
        request_checksum_calculation="when_required",  # other stores know no trailing checksums
        response_checksum_validation="when_required",
        connect_timeout=_CONNECT_S,
        read_timeout=_READ_S,
    )
    try:
        client = boto3.session.Session().client("s3", config=config)
    except (BotoCoreError, ValueError) as error:
        raise CloudError(f"{url}: {error}", "check AWS_ENDPOINT_URL and AWS_PROFILE") from error
    store = S3Store(client, bucket, prefix.strip("/"))
    store.check()
    return store


def _code(error: ClientError) -> str:
    return str(error.response.get("Error", {}).get("Code", "unknown error"))
