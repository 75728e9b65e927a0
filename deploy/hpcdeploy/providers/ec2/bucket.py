"""An S3-compatible bucket between the user's machine and the head.

The credentials stay here: the head gets presigned addresses that end with the lease. Points stay
in the bucket for the next job, a mesh until it is fetched; `down` takes away what is left.
"""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from boto3.exceptions import Boto3Error
from botocore.exceptions import BotoCoreError, ClientError

from hpccomponent.cli.terminal import visible_line
from hpccomponent.errors import CloudError
from hpccomponent.files.paths import expand_home
from hpcdeploy.login.shell import part_of, sha256_of
from hpcdeploy.providers.ec2.client import Client, open_client
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.job_folder import JobOrder, JobStatus

PART = 16 << 20  # 10,000 parts at most, so 160 GB; S3 wants at least 5 MiB
LONGEST_S = 7 * 86400  # of a presigned address
Progress = Callable[[int, int], None]


class S3Bucket:
    """A place in a bucket, ``s3://bucket/prefix``; objects lie below ``prefix/cluster/``.

    Addresses are valid for `valid_s` seconds. By the certificates in `ca_bundle` (PEM) the head
    checks the bucket's own.
    """

    def __init__(
        self, client: Client, url: str, cluster: str, valid_s: float, ca_bundle: str = ""
    ) -> None:
        self._client = client
        self._bucket, _, prefix = url.removeprefix("s3://").partition("/")
        self._prefix = "/".join(part for part in (prefix.strip("/"), cluster) if part)
        self._valid_s = int(min(valid_s, LONGEST_S))
        self._ca_bundle = ca_bundle

    def send(
        self, points: Path, digest: str, order: JobOrder, on_progress: Progress | None = None
    ) -> JobOrder:
        """Send a job's points unless they are there; return the order with its addresses.

        Raises CloudError where the bucket does not take them.
        """
        source = f"{self._prefix}/points/{digest}{points.suffix}"
        target = f"{self._prefix}/meshes/{secrets.token_hex(8)}-{visible_line(order.mesh)}"
        with self._translated():
            self._upload(points, source, on_progress or (lambda _done, _total: None))
            return replace(
                order,
                points_url=self._presign("get_object", source),
                mesh_url=self._presign("put_object", target),
                mesh_key=target,
                ca_bundle=self._ca_bundle,
            )

    def fetch(self, status: JobStatus, target: Path) -> None:
        """Fetch a job's mesh, check it, and take it out of the bucket.

        `status` has the mesh's key and SHA-256. Raises CloudError where the bucket does not give
        it, or gives another; or where the head names an object that is no mesh of this name.
        """
        self._check_key(status)
        part = part_of(target)
        try:
            with self._translated():
                self._client.download_file(self._bucket, status.mesh_key, str(part))
            if sha256_of(part) != status.mesh_sha256:
                raise CloudError(
                    f"{self._bucket}/{status.mesh_key} is not the mesh that was sent",
                    "fetch it with 'hpcapp get'",
                )
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
        with self._translated():
            self._client.delete_object(Bucket=self._bucket, Key=status.mesh_key)

    def _check_key(self, status: JobStatus) -> None:
        """Refuse a key that the head has not from us: we read and remove the object."""
        ours = rf"/meshes/[0-9a-f]{{16}}-{re.escape(visible_line(status.mesh))}"
        if not re.fullmatch(re.escape(self._prefix) + ours, status.mesh_key):
            raise CloudError(
                f"job {status.job}: the head names {status.mesh_key!r} in the bucket, "
                f"which is no {status.mesh} that a job has put there",
                "look at the head: it does not say what was written there",
            )

    def clear(self) -> None:
        """Take away all that the cluster's jobs have put there, and uploads that were cut short.

        Raises CloudError where the bucket does not let us.
        """
        where = {"Bucket": self._bucket, "Prefix": f"{self._prefix}/"}
        with self._translated():
            try:
                for upload in self._begun(f"{self._prefix}/"):
                    self._abort({key: upload[key] for key in ("Key", "UploadId")})
                pages = self._client.get_paginator("list_objects_v2").paginate(**where)
                for key in [item["Key"] for page in pages for item in page.get("Contents", ())]:
                    if self._is_ours(key):
                        self._client.delete_object(Bucket=self._bucket, Key=key)
            except self._client.exceptions.NoSuchBucket:
                return

    def _is_ours(self, key: str) -> bool:
        """Tell whether we have given an object its name."""
        ours = r"/(points/[0-9a-f]{64}\.|meshes/[0-9a-f]{16}-)[^/]*"
        return re.fullmatch(re.escape(self._prefix) + ours, key) is not None

    def _presign(self, operation: str, key: str) -> str:
        url: str = self._client.generate_presigned_url(
            operation, Params={"Bucket": self._bucket, "Key": key}, ExpiresIn=self._valid_s
        )
        return url

    def _upload(self, path: Path, key: str, on_progress: Progress) -> None:
        """Send a file in parts; those that an earlier attempt has sent are not sent again.

        The object is named by its content, so that a part of the same number is the same part.
        """
        size = path.stat().st_size
        listed = self._client.list_objects_v2(Bucket=self._bucket, Prefix=key)
        if any(item["Key"] == key and item["Size"] == size for item in listed.get("Contents", ())):
            return
        if size <= PART:
            self._client.put_object(Bucket=self._bucket, Key=key, Body=path.read_bytes())
            on_progress(size, size)
            return
        where = {"Key": key, "UploadId": self._find_upload(key)}
        try:
            self._send_parts(path, size, where, on_progress)
        except ClientError:  # it would be refused again; what was cut short otherwise goes on
            self._abort(where)
            raise

    def _send_parts(
        self, path: Path, size: int, where: dict[str, str], on_progress: Progress
    ) -> None:
        where = {"Bucket": self._bucket, **where}
        sent = self._sent_parts(where)
        parts = []
        with path.open("rb") as stream:
            for number, start in enumerate(range(0, size, PART), start=1):
                length = min(PART, size - start)
                tag, length_there = sent.get(number, ("", 0))
                if length_there != length:
                    stream.seek(start)
                    body = stream.read(length)
                    tag = self._client.upload_part(**where, PartNumber=number, Body=body)["ETag"]
                parts.append({"PartNumber": number, "ETag": tag})
                on_progress(start + length, size)
        self._client.complete_multipart_upload(**where, MultipartUpload={"Parts": parts})

    def _find_upload(self, key: str) -> str:
        """Return the upload that an earlier attempt has begun, or a new one."""
        for upload in self._begun(key):
            return str(upload["UploadId"])
        made = self._client.create_multipart_upload(Bucket=self._bucket, Key=key)
        return str(made["UploadId"])

    def _begun(self, prefix: str) -> list[dict[str, str]]:
        """Return our uploads that were not finished, of objects whose names begin so."""
        begun = self._client.list_multipart_uploads(Bucket=self._bucket, Prefix=prefix)
        return [upload for upload in begun.get("Uploads", ()) if self._is_ours(upload["Key"])]

    def _abort(self, where: dict[str, str]) -> None:
        """Give an upload up, so that its parts cost nothing."""
        with suppress(self._client.exceptions.NoSuchUpload):
            self._client.abort_multipart_upload(Bucket=self._bucket, **where)

    def _sent_parts(self, where: dict[str, str]) -> dict[int, tuple[str, int]]:
        """Return tag and length of the parts that are there, by their number."""
        pages = self._client.get_paginator("list_parts").paginate(**where)
        return {
            part["PartNumber"]: (part["ETag"], part["Size"])
            for page in pages
            for part in page.get("Parts", ())
        }

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Turn what boto3 raises into one line."""
        try:
            yield
        except ClientError as error:
            code = error.response.get("Error", {}).get("Code", "unknown error")
            raise CloudError(
                f"s3://{self._bucket}: {error.operation_name} was refused ({code})",
                "check data.s3 in the cluster file and the rights of the credentials",
            ) from error
        except (Boto3Error, BotoCoreError) as error:
            raise CloudError(
                f"s3://{self._bucket}: {error}", "check data.s3 and s3_endpoint_url"
            ) from error


def open_bucket(spec: ClusterSpec, base: Path) -> S3Bucket | None:
    """Return the bucket that a cluster file names in ``data.s3``; None where it names none."""
    cloud = spec.provider.cloud
    if cloud is None or spec.data.s3 is None:
        return None
    bundle = (base / expand_home(cloud.ca_bundle)).read_text() if cloud.ca_bundle else ""
    client = open_client("s3", cloud, base)
    return S3Bucket(client, spec.data.s3, spec.cluster, spec.limits.lease, bundle)
