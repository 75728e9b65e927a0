"""Keys are found where people have them, and shell files are read without being run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter

from hpccomponent.errors import CloudError
from hpcdeploy.providers.ec2.client import open_client
from hpcdeploy.providers.ec2.credentials import find_keys
from hpcdeploy.spec.provider import CloudSpec

INI = """
[global]
default-region = lab
[user 1234:alice]
key-id = AKALICE
secret-key = s%cret/alice
[user 1234:bob]
key-id = AKBOB
secret-key = bob
[region lab]
user = 1234:alice
ec2-url = http://clc.lab:8773/services/compute/
s3-url = http://clc.lab:8773/services/objectstorage/
certificate = /etc/lab.pem
[region other]
user = 1234:bob
ec2-url = http://other:8773/services/compute/
"""
EUCARC = """
EUCA_KEY_DIR=$(cd $(dirname ${BASH_SOURCE:-$0}); pwd -P)
export EC2_URL=http://clc.lab:8773/services/compute/
export S3_URL="http://clc.lab:8773/services/objectstorage/"
export EUCALYPTUS_CERT=${EUCA_KEY_DIR}/cloud-cert.pem
export AWS_ACCESS_KEY='AKRC'   # a comment
export AWS_SECRET_KEY='s3cr#t'
alias ec2-bundle-image="ec2-bundle-image --cert ${EC2_CERT}"
touch run-by-a-shell
"""


def cloud(kind: str = "eucalyptus", **more: Any) -> CloudSpec:
    profiles = {"small": {"image": {"id": "emi-1"}, "instance_type": "m1.small"}}
    spec: CloudSpec = TypeAdapter(CloudSpec).validate_python(
        {"type": kind, "profiles": profiles, **more}
    )
    return spec


@pytest.mark.parametrize(
    ("region", "key"), [("lab", "AKALICE"), ("other", "AKBOB"), ("eucalyptus", "AKALICE")]
)
def test_euca2ools(tmp_path: Path, region: str, key: str) -> None:
    (tmp_path / "lab.ini").write_text(INI)
    keys = find_keys(cloud(region=region, credentials={"euca_ini": "lab.ini"}), tmp_path, {})
    assert keys.access_key == key
    if key == "AKALICE":
        assert (keys.secret_key, keys.ca_bundle) == ("s%cret/alice", "/etc/lab.pem")
        assert keys.ec2_url == "http://clc.lab:8773/services/compute/"
        assert keys.s3_url == "http://clc.lab:8773/services/objectstorage/"


def test_euca2ools_with_two_users_and_no_choice(tmp_path: Path) -> None:
    (tmp_path / "lab.ini").write_text(INI.replace("user = 1234:alice\n", ""))
    with pytest.raises(CloudError, match=r"lab\.ini: no keys .*1234:alice, 1234:bob.*user = ACC"):
        find_keys(cloud(region="lab", credentials={"euca_ini": "lab.ini"}), tmp_path, {})


def test_eucarc_is_read_and_not_run(tmp_path: Path) -> None:
    (tmp_path / "eucarc").write_text(EUCARC)
    keys = find_keys(cloud(credentials={"eucarc": "eucarc"}), tmp_path, {})
    assert (keys.access_key, keys.secret_key) == ("AKRC", "s3cr#t")
    assert keys.ec2_url == "http://clc.lab:8773/services/compute/"
    assert keys.ca_bundle == str(tmp_path / "cloud-cert.pem")
    assert [path.name for path in tmp_path.iterdir()] == ["eucarc"]
    assert "s3cr#t" not in repr(keys)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (None, "cannot be read"),
        ("export EC2_URL=http://x\n", "exports no keys"),
        ("export AWS_ACCESS_KEY='x\n", "no shell text"),
    ],
)
def test_an_eucarc_that_is_none(tmp_path: Path, content: str | None, line: str) -> None:
    if content is not None:
        (tmp_path / "eucarc").write_text(content)
    with pytest.raises(CloudError, match=line):
        find_keys(cloud(credentials={"eucarc": "eucarc"}), tmp_path, {})


def test_an_ini_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "lab.ini").write_text("key-id = 1\n")
    with pytest.raises(CloudError, match=r"lab\.ini"):
        find_keys(cloud(credentials={"euca_ini": "lab.ini"}), tmp_path, {})


@pytest.mark.parametrize(
    "names",
    [
        ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"),
        ("AWS_ACCESS_KEY", "AWS_SECRET_KEY"),
        ("EC2_ACCESS_KEY", "EC2_SECRET_KEY"),
    ],
)
def test_the_environment_names_them_in_many_ways(tmp_path: Path, names: tuple[str, str]) -> None:
    environment = {names[0]: "AK", names[1]: "s", "EC2_URL": "http://clc/"}
    keys = find_keys(cloud(), tmp_path, environment)
    assert (keys.access_key, keys.secret_key, keys.ec2_url) == ("AK", "s", "http://clc/")


def test_amazon_is_left_to_its_own_chain(tmp_path: Path) -> None:
    environment = {"AWS_ACCESS_KEY_ID": "AK", "EC2_URL": "http://clc/"}
    keys = find_keys(cloud("aws"), tmp_path, environment)
    assert (keys.access_key, keys.ec2_url) == (None, None)
    named = find_keys(cloud("aws", credentials={"profile": "lab"}), tmp_path, environment)
    assert named.profile == "lab"


@pytest.fixture
def own_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    for name in ("EC2_URL", "S3_URL", "AWS_PROFILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AK")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "config"))
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "credentials"))
    return tmp_path


def test_what_the_cluster_file_says_overrules(
    own_environment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EC2_URL", "http://127.0.0.1:1/services/compute/")
    client = open_client("ec2", cloud(), own_environment)
    assert client.meta.endpoint_url == "http://127.0.0.1:1/services/compute/"
    named = cloud(endpoint_url="http://127.0.0.1:2/services/compute/", signing_region="lab")
    client = open_client("ec2", named, own_environment)
    assert client.meta.endpoint_url == "http://127.0.0.1:2/services/compute/"
    assert (client.meta.region_name, client.meta.service_model.api_version) == ("lab", "2014-09-01")
    client = open_client("s3", cloud(s3_endpoint_url="http://127.0.0.1:3/"), own_environment)
    assert client.meta.config.s3 == {"addressing_style": "path"}


@pytest.mark.parametrize(
    ("service", "more", "line"),
    [
        ("ec2", {}, r"set provider\.endpoint_url"),
        ("s3", {}, r"set provider\.s3_endpoint_url"),
        (
            "ec2",
            {"endpoint_url": "http://127.0.0.1:1", "credentials": {"profile": "missing"}},
            "list-profiles",
        ),
    ],
)
def test_what_cannot_be_opened(
    own_environment: Path, service: str, more: dict[str, Any], line: str
) -> None:
    with pytest.raises(CloudError, match=line):
        open_client(service, cloud(**more), own_environment)


def test_a_dotted_region_needs_a_signing_region(own_environment: Path) -> None:
    dotted = cloud("aws", region="cloud.example.org")
    with pytest.raises(CloudError, match=r"provider\.signing_region"):
        open_client("ec2", dotted, own_environment)
