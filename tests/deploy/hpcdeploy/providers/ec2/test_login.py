"""Keys that cannot be had, clouds that cannot be reached: named in one line, in bounded time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from hashlib import sha1
from pathlib import Path
from typing import Any

import pytest
from cloud import StrictCloud
from cloud.broken import BrokenWays, Fault, answering
from cloud.signature import SECRET_KEY
from pydantic import TypeAdapter

from hpccomponent.errors import CloudError
from hpcdeploy.providers.clouds import open_clouds
from hpcdeploy.providers.ec2.client import open_calls
from hpcdeploy.providers.ec2.login import CloudTimeouts
from hpcdeploy.providers.ec2.provider import Ec2Provider
from hpcdeploy.spec.names import Owner
from hpcdeploy.spec.provider import CloudSpec, ProviderSpec

_SPEC: TypeAdapter[Any] = TypeAdapter(ProviderSpec)
SHORT = CloudTimeouts(connect_s=0.3, keys_s=0.5, process_s=0.5, ask_s=0.5, act_s=0.5)
ALONE = {"role refused port", "role with MFA", "SSO never", "SSO expired", "legacy SSO expired"}
"""These ask a terminal, or read what is below the home that a process has begun with."""


@pytest.fixture
def ways(tmp_path: Path, no_keys: None) -> Iterator[BrokenWays]:
    with BrokenWays(tmp_path) as ways:
        yield ways


@pytest.fixture
def no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith(("AWS_", "EC2_"))]:
        monkeypatch.delenv(name)


def cloud(fault: Fault) -> CloudSpec:
    credentials = {"profile": fault.profile} if fault.profile else {}
    spec: CloudSpec = _SPEC.validate_python(
        {
            "type": "aws",
            "endpoint_url": fault.endpoint_url,
            "credentials": credentials,
            "profiles": {"small": {"image": {"id": "ami-1"}, "instance_type": "m5.large"}},
        }
    )
    return spec


def observe(spec: CloudSpec, base: Path) -> Ec2Provider:
    provider = Ec2Provider(spec, open_calls(spec, base, SHORT, lambda _: None), 22)
    provider.observe("bunny")
    return provider


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_every_fault_is_one_line_with_what_mends_it_and_ends_in_time(
    ways: BrokenWays, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for fault in ways.faults():
        if fault.name in ALONE:
            continue
        with monkeypatch.context() as patch:
            for name, value in ways.environment(fault).items():
                patch.setenv(name, value)
            with pytest.raises(CloudError) as caught:
                observe(cloud(fault), tmp_path)
        line = str(caught.value)
        assert "\n" not in line
        assert "hush" not in line, "a proxy's password"
        assert not [word for word in fault.says if word not in line], f"{fault.name}: {line}"


def test_the_terminal_shows_one_line_and_no_traceback(ways: BrokenWays) -> None:
    for fault in ways.faults():
        if fault.name not in ALONE:
            continue
        environment = ways.environment(fault)
        file = Path(environment["HOME"]) / "cluster.yaml"
        provider = cloud(fault).model_dump(mode="json", exclude_none=True)
        file.write_text(json.dumps({"version": 1, "cluster": "bunny", "provider": provider}))
        done = subprocess.run(
            [sys.executable, "-P", "-m", "hpcapp", "status", str(file)],
            env={**os.environ, **environment},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            start_new_session=True,  # no terminal to ask
            timeout=60,
            check=False,
        )
        assert (done.returncode, done.stdout) == (4, ""), done.stderr
        assert done.stderr.count("\n") == 1, done.stderr
        assert not [word for word in fault.says if word not in done.stderr], done.stderr


@pytest.fixture
def strict(monkeypatch: pytest.MonkeyPatch, no_keys: None) -> Iterator[StrictCloud]:
    with StrictCloud("aws") as cloud:
        environment = cloud.environment()
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            del environment[name]
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        yield cloud


def strict_spec(strict: StrictCloud) -> CloudSpec:
    block = strict.provider_block() | {"credentials": {"profile": "lab"}}
    spec: CloudSpec = _SPEC.validate_python(block)
    return spec


def keys_of(access_key: str) -> str:
    return f"[lab]\naws_access_key_id = {access_key}\naws_secret_access_key = {SECRET_KEY}\n"


@pytest.mark.parametrize("code", ["ExpiredToken", "RequestExpired"])
def test_keys_that_expire_in_mid_work_and_are_renewed_on_disk_are_taken(
    strict: StrictCloud, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, code: str
) -> None:
    file = tmp_path / "credentials"
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(file))
    file.write_text(keys_of(strict.access_key))
    provider = observe(strict_spec(strict), tmp_path)
    strict.access_key = "AKIANEWER00000000000"  # the cloud knows the newer ones only
    strict.fail("DescribeInstances", code, 400)
    file.write_text(keys_of(strict.access_key))
    provider.observe("bunny")
    provider.create_group("bunny", "life", Owner())  # changes go by the newer ones too
    assert [group.cluster for group in provider.observe("bunny").lives] == ["bunny"]


def test_keys_that_expired_and_are_not_renewed_are_said_to_be(
    strict: StrictCloud, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "credentials"
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(file))
    file.write_text(keys_of(strict.access_key))
    provider = observe(strict_spec(strict), tmp_path)
    before = len(strict.calls)
    strict.fail("DescribeInstances", "ExpiredToken", 400, times=2)
    with pytest.raises(CloudError, match="get new credentials"):
        provider.observe("bunny")
    assert len(strict.calls) == before + 2


def test_a_role_is_assumed_again_before_its_keys_expire(
    strict: StrictCloud, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    config = tmp_path / "config"
    config.write_text(
        "[profile lab]\nrole_arn = arn:aws:iam::1:role/lab\nsource_profile = own\n"
        "[profile own]\naws_access_key_id = AKIA\naws_secret_access_key = x\n"
    )
    monkeypatch.setenv("AWS_CONFIG_FILE", str(config))
    with answering(200, role_page(strict)) as sts:
        monkeypatch.setenv("AWS_ENDPOINT_URL_STS", f"http://{sts}")
        provider = observe(strict_spec(strict), tmp_path)
        strict.access_key = "AKIANEWER00000000000"
        provider.observe("bunny")


def role_page(strict: StrictCloud) -> Callable[[], str]:
    """Return what gives the keys that a cloud knows by now, for half a minute."""

    def page() -> str:
        until = (datetime.now(UTC) + timedelta(seconds=30)).strftime("%Y-%m-%dT%H:%M:%SZ")
        return f"""<AssumeRoleResponse xmlns="https://sts.amazonaws.com/doc/2011-06-15/">
<AssumeRoleResult><AssumedRoleUser><Arn>a</Arn><AssumedRoleId>b</AssumedRoleId></AssumedRoleUser>
<Credentials><AccessKeyId>{strict.access_key}</AccessKeyId>
<SecretAccessKey>{SECRET_KEY}</SecretAccessKey><SessionToken>t</SessionToken>
<Expiration>{until}</Expiration></Credentials></AssumeRoleResult></AssumeRoleResponse>"""

    return page


def test_without_a_file_the_region_is_the_profiles(
    strict: StrictCloud, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    config = tmp_path / "config"
    config.write_text("[profile lab]\nregion = eu-west-3\n")
    monkeypatch.setenv("AWS_CONFIG_FILE", str(config))
    monkeypatch.setenv("AWS_PROFILE", "lab")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIA")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "x")
    assert [cloud.place for cloud in open_clouds(())] == ["aws eu-west-3"]
    monkeypatch.setenv("AWS_PROFILE", "gone")
    with pytest.raises(CloudError, match="there is no profile gone"):
        open_clouds(())


def test_a_role_that_was_assumed_with_a_code_before_asks_for_none(
    strict: StrictCloud, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    role, serial = "arn:aws:iam::1:role/lab", "arn:aws:iam::1:mfa/me"
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "config"))
    (tmp_path / "config").write_text(
        f"[profile lab]\nrole_arn = {role}\nmfa_serial = {serial}\nsource_profile = own\n"
        "[profile own]\naws_access_key_id = AKIA\naws_secret_access_key = x\n"
    )
    arguments = json.dumps({"RoleArn": role, "SerialNumber": serial}, sort_keys=True)
    name = sha1(arguments.encode()).hexdigest()  # noqa: S324 - as AWS names the file
    known = tmp_path / f".aws/cli/cache/{name}.json"
    known.parent.mkdir(parents=True)

    def assume() -> None:
        """Do what AWS's own command line does once it has got the code."""
        until = datetime.now(UTC) + timedelta(hours=1)
        keys = {
            "AccessKeyId": strict.access_key,
            "SecretAccessKey": SECRET_KEY,
            "SessionToken": "t",
            "Expiration": until.isoformat(),
        }
        known.write_text(json.dumps({"Credentials": keys}))

    assume()
    provider = observe(strict_spec(strict), tmp_path)
    strict.access_key = "AKIANEWER00000000000"
    strict.fail("DescribeInstances", "RequestExpired", 400)
    assume()
    provider.observe("bunny")
