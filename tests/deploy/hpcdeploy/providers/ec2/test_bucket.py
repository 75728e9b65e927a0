"""A bucket of moto's server between the user's machine and the head."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import boto3
import pytest
from botocore.config import Config
from botocore.exceptions import ClientError
from heads import install_python, write_sphere
from moto.server import ThreadedMotoServer
from simulated import make_cluster, make_spec
from simulated.memory import MemoryProvider

from hpccomponent.errors import CloudError
from hpcdeploy.jobs import bucket_client
from hpcdeploy.jobs.bucket_client import fetch_points, send_mesh
from hpcdeploy.jobs.display import JobDisplay
from hpcdeploy.jobs.queries import Jobs
from hpcdeploy.login.local_shell import LocalShell
from hpcdeploy.login.shell import sha256_of
from hpcdeploy.providers.ec2 import bucket as bucket_module
from hpcdeploy.providers.ec2.bucket import S3Bucket, open_bucket
from hpcdeploy.reconcile.converge import take_down
from hpcdeploy.spec.cluster import Data
from hpcdeploy.spec.job_folder import JobOrder, JobState, JobStatus

ORDER = JobOrder("reconstruct", "points/x.ply", "mesh.ply")


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def client(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    client = boto3.session.Session().client(
        "s3",
        region_name="us-east-1",
        endpoint_url=endpoint,
        aws_access_key_id="AKIA",
        aws_secret_access_key="not-for-the-head",  # noqa: S106
        config=Config(
            s3={"addressing_style": "path"},
            request_checksum_calculation="when_required",
            response_checksum_validation="when_required",
            retries={"total_max_attempts": 1},
        ),
    )
    client.create_bucket(Bucket="lab")
    yield client
    for item in client.list_objects_v2(Bucket="lab").get("Contents", ()):
        client.delete_object(Bucket="lab", Key=item["Key"])
    client.delete_bucket(Bucket="lab")
    client.close()


@pytest.fixture
def bucket(client: Any) -> S3Bucket:
    return S3Bucket(client, "s3://lab/scans/", "bunny", 3600.0)


def write(path: Path, size: int) -> str:
    path.write_bytes(os.urandom(size))
    return sha256_of(path)


def keys(client: Any) -> list[str]:
    return [item["Key"] for item in client.list_objects_v2(Bucket="lab").get("Contents", ())]


def test_points_go_up_and_the_mesh_comes_down(
    bucket: S3Bucket, client: Any, tmp_path: Path
) -> None:
    digest = write(tmp_path / "a.ply", 1000)
    order = bucket.send(tmp_path / "a.ply", digest, ORDER)
    assert "not-for-the-head" not in repr(order)
    assert keys(client) == [f"scans/bunny/points/{digest}.ply"]
    said: list[str] = []
    fetch_points(order, tmp_path / f"head/{digest}.ply", said.append)
    assert sha256_of(tmp_path / f"head/{digest}.ply") == digest
    mesh = write(tmp_path / "mesh.ply", 5000)
    assert send_mesh(order, tmp_path / "mesh.ply", said.append) == mesh
    status = JobStatus(
        "1", JobState.DONE, mesh="mesh.ply", mesh_key=order.mesh_key, mesh_sha256=mesh
    )
    bucket.fetch(status, tmp_path / "fetched.ply")
    assert sha256_of(tmp_path / "fetched.ply") == mesh
    assert order.mesh_key not in keys(client)


def test_a_mesh_may_have_any_name(bucket: S3Bucket, client: Any, tmp_path: Path) -> None:
    odd = os.fsdecode(b"\xff\xfe.ply")
    order = bucket.send(tmp_path / "a.ply", write(tmp_path / "a.ply", 9), replace(ORDER, mesh=odd))
    mesh = write(tmp_path / odd, 5000)
    assert send_mesh(order, tmp_path / odd, lambda _: None) == mesh
    status = JobStatus("1", JobState.DONE, mesh=odd, mesh_key=order.mesh_key, mesh_sha256=mesh)
    bucket.fetch(status, tmp_path / f"back {odd}")
    assert sha256_of(tmp_path / f"back {odd}") == mesh


def test_what_is_there_is_not_sent_again(
    bucket: S3Bucket, client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = write(tmp_path / "a.ply", 1000)
    bucket.send(tmp_path / "a.ply", digest, ORDER)
    monkeypatch.setattr(client, "put_object", None)
    bucket.send(tmp_path / "a.ply", digest, ORDER)


def test_an_interrupted_upload_goes_on(
    bucket: S3Bucket, client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = 5 << 20
    monkeypatch.setattr(bucket_module, "PART", part)
    digest = write(tmp_path / "a.ply", 2 * part + 7)

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bucket.send(tmp_path / "a.ply", digest, ORDER, interrupt)
    sent: list[int] = []
    upload_part = client.upload_part

    def upload(**call: Any) -> Any:
        sent.append(call["PartNumber"])
        return upload_part(**call)

    monkeypatch.setattr(client, "upload_part", upload)
    progress: list[int] = []
    order = bucket.send(tmp_path / "a.ply", digest, ORDER, lambda done, _: progress.append(done))
    assert sent == [2, 3]
    assert progress == [part, 2 * part, 2 * part + 7]
    fetch_points(order, tmp_path / f"{digest}.ply", lambda _: None)


def test_a_download_goes_on_where_it_stopped(
    bucket: S3Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = write(tmp_path / "a.ply", 1000)
    order = bucket.send(tmp_path / "a.ply", digest, ORDER)
    content = (tmp_path / "a.ply").read_bytes()
    for have in (400, 1000):
        target = tmp_path / f"{have}" / f"{digest}.ply"
        target.parent.mkdir()
        target.with_name(target.name + ".part").write_bytes(content[:have])
        fetch_points(order, target, lambda _: None)
        assert target.read_bytes() == content


def test_other_points_are_refused(bucket: S3Bucket, client: Any, tmp_path: Path) -> None:
    digest = write(tmp_path / "a.ply", 1000)
    order = bucket.send(tmp_path / "a.ply", digest, ORDER)
    client.put_object(Bucket="lab", Key=keys(client)[0], Body=b"others")
    with pytest.raises(CloudError, match="other points than were sent"):
        fetch_points(order, tmp_path / f"{digest}.ply", lambda _: None)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_a_mesh_that_was_changed_is_refused(bucket: S3Bucket, client: Any, tmp_path: Path) -> None:
    key = f"scans/bunny/meshes/{'0' * 16}-mesh.ply"
    client.put_object(Bucket="lab", Key=key, Body=b"others")
    status = JobStatus(
        "1", JobState.DONE, mesh="mesh.ply", mesh_key=key, mesh_sha256=hashlib.sha256().hexdigest()
    )
    with pytest.raises(CloudError, match="not the mesh that was sent"):
        bucket.fetch(status, tmp_path / "mesh.ply")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "key",
    [
        "thesis.pdf",
        "scans/bunny/points/" + "0" * 64 + ".ply",
        "scans/other/meshes/" + "0" * 16 + "-mesh.ply",
        "scans/bunny/meshes/" + "0" * 16 + "-mesh.ply/../../../thesis.pdf",
        "scans/bunny/meshes/" + "0" * 16 + "-another.ply",
        "",
    ],
)
def test_a_head_has_nothing_read_or_removed_but_its_job_s_mesh(
    bucket: S3Bucket, client: Any, tmp_path: Path, key: str
) -> None:
    content = b"what the head knows"
    if key:
        client.put_object(Bucket="lab", Key=key, Body=content)
    digest = hashlib.sha256(content).hexdigest()
    status = JobStatus("1", JobState.DONE, mesh="mesh.ply", mesh_key=key, mesh_sha256=digest)
    with pytest.raises(CloudError, match=r"is no mesh\.ply that a job has put there"):
        bucket.fetch(status, tmp_path / "mesh.ply")
    assert list(tmp_path.iterdir()) == []
    assert keys(client) == [key] * bool(key)


def test_a_bucket_that_is_gone_is_one_line(
    bucket: S3Bucket, client: Any, tmp_path: Path, endpoint: str
) -> None:
    digest = write(tmp_path / "a.ply", 1000)
    nowhere = S3Bucket(client, "s3://no-such-bucket", "bunny", 60.0)
    with pytest.raises(CloudError, match=r"s3://no-such-bucket: .* was refused \(NoSuchBucket\)"):
        nowhere.send(tmp_path / "a.ply", digest, ORDER)
    order = replace(ORDER, points_url=f"{endpoint}/lab/none", mesh_url=f"{endpoint}/none/none")
    with pytest.raises(CloudError, match=r"cannot be fetched from the bucket \(HTTP Error 40"):
        fetch_points(order, tmp_path / "none.ply", lambda _: None)
    said: list[str] = []
    assert send_mesh(order, tmp_path / "a.ply", said.append) == ""
    assert "it stays on the head" in said[-1]


def test_a_bucket_that_cannot_be_reached_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bucket_client, "ATTEMPTS", 2)
    order = replace(ORDER, points_url="http://127.0.0.1:1/x")
    with pytest.raises(CloudError, match="Connection refused"):
        fetch_points(order, tmp_path / "x.ply", lambda _: None)


def test_a_refused_upload_is_given_up(
    bucket: S3Bucket, client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bucket_module, "PART", 5 << 20)
    digest = write(tmp_path / "a.ply", 6 << 20)
    denied = {"Error": {"Code": "AccessDenied"}}

    def refuse(**call: Any) -> None:
        assert begun(client)
        raise ClientError(denied, "UploadPart")

    monkeypatch.setattr(client, "upload_part", refuse)
    with pytest.raises(CloudError, match=r"UploadPart was refused \(AccessDenied\)"):
        bucket.send(tmp_path / "a.ply", digest, ORDER)
    assert begun(client) == []


def begun(client: Any) -> list[str]:
    uploads = client.list_multipart_uploads(Bucket="lab").get("Uploads", ())
    return [upload["Key"] for upload in uploads]


def test_down_leaves_nothing_of_ours_in_the_bucket(
    bucket: S3Bucket, client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("hpcdeploy.providers.ec2.bucket.open_client", lambda *_: client)
    order = bucket.send(tmp_path / "a.ply", write(tmp_path / "a.ply", 1000), ORDER)
    assert send_mesh(order, tmp_path / "a.ply", lambda _: None)
    client.create_multipart_upload(Bucket="lab", Key=f"scans/bunny/points/{64 * '0'}.ply")
    theirs = ["scans/bunny/notes.txt", "scans/bunny/points/mine.ply", "scans/bunny2/x.ply"]
    for key in theirs:
        client.put_object(Bucket="lab", Key=key, Body=b"stays")
    spec = make_spec().model_copy(update={"data": Data(s3="s3://lab/scans/")})
    cloud = MemoryProvider()
    cloud.store = open_bucket(spec, tmp_path)
    take_down(make_cluster(spec, cloud), print)
    assert keys(client) == theirs
    assert begun(client) == []
    gone = spec.model_copy(update={"data": Data(s3="s3://no-such-bucket")})
    take_down(make_cluster(gone, MemoryProvider()), print)


def test_a_job_gets_its_points_and_gives_its_mesh_by_way_of_the_bucket(
    bucket: S3Bucket, client: Any, tmp_path: Path, standing_cluster: Callable[..., Any]
) -> None:
    folder = tmp_path / "home/hpcapp/standing"
    install_python(folder)
    standing_cluster(folder)
    points = write_sphere(tmp_path / "sphere.xyz")
    jobs = Jobs(LocalShell("head", tmp_path / "home"), "standing", bucket)
    status = jobs.submit("reconstruct", points, "mesh.ply", ("--grid", "32"))
    status = jobs.follow(status.job, JobDisplay())
    assert status.state is JobState.DONE, jobs.log(status.job)
    assert {"fetching the points from the bucket", "sending the mesh to the bucket"} < {
        *jobs.log(status.job)
    }
    assert status.mesh_key in keys(client)
    there = folder / "jobs" / status.job / "mesh.ply"
    content = there.read_bytes()
    there.unlink()  # so that the bucket alone has it
    assert jobs.fetch(status, tmp_path / "mesh.ply")["watertight"]
    assert (tmp_path / "mesh.ply").read_bytes() == content
    [left] = keys(client)
    assert left.endswith(f"{sha256_of(points)}.xyz")
    for file in ("status.json", "log", "events.jsonl", "report.json"):
        assert "Signature" not in (folder / "jobs" / status.job / file).read_text()
