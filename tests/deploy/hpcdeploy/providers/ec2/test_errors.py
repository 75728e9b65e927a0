"""Every error of a cloud is one line that says what, where and what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import pytest
from botocore.exceptions import ClientError
from cloud import FOREVER
from cloud.broken import self_signed_server

from hpccomponent.errors import CapacityError, CloudError
from hpcdeploy.providers.ec2.errors import code_of, is_lost_answer, is_throttled, translate

from .conftest import Desk

OpenDesk = Callable[..., Desk]


def refused(code: str, message: str = "no", status: int = 400) -> ClientError:
    answer: Any = {
        "Error": {"Code": code, "Message": message},
        "ResponseMetadata": {"HTTPStatusCode": status},
    }
    return ClientError(answer, "RunInstances")


@pytest.mark.parametrize(
    ("code", "advice"),
    [
        ("AuthFailure", "provider.credentials"),
        ("InvalidClientTokenId", "provider.credentials"),
        ("SignatureDoesNotMatch", "secret key"),
        ("ExpiredToken", "get new credentials"),
        ("RequestExpired", "clock"),
        ("UnauthorizedOperation", "lack the right ec2:RunInstances"),
        ("InvalidAMIID.NotFound", "image.id"),
        ("InvalidAMIID.Malformed", "image.id"),
        ("InvalidSubnetID.NotFound", "provider.subnet"),
        ("VPCIdNotSpecified", "provider.subnet"),
        ("InvalidKey.Format", "RSA"),
        ("InvalidAction", "provider.capabilities"),
        ("InvalidBlockDeviceMapping", "disk_gb"),
        ("OptInRequired", "subscribe"),
        ("RequestLimitExceeded", "again in a minute"),
    ],
)
def test_codes_come_with_advice(code: str, advice: str) -> None:
    error = translate(refused(code, "It was refused."), "launch head", "aws (us-east-1)")
    assert type(error) is CloudError
    assert error.problem == f"aws (us-east-1): cannot launch head: It was refused ({code})"
    assert advice in error.advice


@pytest.mark.parametrize(
    "code",
    [
        "InsufficientInstanceCapacity",
        "InsufficientFreeAddressesInSubnet",
        "InstanceLimitExceeded",
        "MaxSpotInstanceCountExceeded",
        "SpotMaxPriceTooLow",
        "Unsupported",
        "VcpuLimitExceeded",
    ],
)
def test_what_another_type_or_market_may_still_give(code: str) -> None:
    error = translate(refused(code, status=500), "launch head", "aws")
    assert type(error) is CapacityError
    assert error.advice
    assert not is_lost_answer(refused(code, status=500))
    assert not is_throttled(refused(code))


def test_an_unknown_code_is_told_as_it_is() -> None:
    error = translate(refused("Brand.New", "Something\n  new."), "launch head", "aws")
    assert str(error) == "aws: cannot launch head: Something new (Brand.New)"


def test_a_cipher_is_left_out() -> None:
    message = "You are not authorized. Encoded authorization failure message: " + "x" * 900
    error = translate(refused("UnauthorizedOperation", message), "launch head", "aws")
    assert "xxx" not in str(error)


def test_a_translated_error_still_tells_its_code() -> None:
    error = translate(refused("A"), "launch", "aws")
    error.__cause__ = refused("A")  # as `raise ... from` has it
    assert code_of(error) == "A"
    assert code_of(CloudError("ours")) == ""


def test_a_server_that_fails_may_have_done_it() -> None:
    assert is_lost_answer(refused("InternalError", status=500))
    assert not is_lost_answer(refused("AuthFailure", status=401))


@pytest.mark.parametrize("profile", ["aws", "euca-4.0", "generic"])
def test_wrong_keys(
    open_desk: OpenDesk, monkeypatch: pytest.MonkeyPatch, profile: str, tmp_path: Path
) -> None:
    desk = open_desk(profile)
    for name, line in (
        ("AWS_SECRET_ACCESS_KEY", "secret key is not the access key's"),
        ("AWS_ACCESS_KEY_ID", "check provider.credentials"),
    ):
        monkeypatch.setenv(name, "wrong")
        again = desk.reopened(tmp_path)
        with pytest.raises(CloudError, match=line):
            again.observe("bunny")
    assert desk.waits == []


def test_no_keys_at_all(open_desk: OpenDesk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk = open_desk("aws")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    with pytest.raises(CloudError, match="set AWS_ACCESS_KEY_ID"):
        desk.reopened().observe("bunny")


def test_expired_keys(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    desk.cloud.fail("*", "ExpiredToken", 400, times=FOREVER)
    with pytest.raises(CloudError, match="get new credentials"):
        desk.provider.observe("bunny")
    assert len(desk.cloud.calls) == 1


@pytest.mark.parametrize("action", ["CreateSecurityGroup", "ImportKeyPair"])
def test_a_right_that_is_missing_is_named(open_desk: OpenDesk, action: str) -> None:
    desk = open_desk("aws")
    desk.cloud.no_rights = {action}
    with pytest.raises(CloudError, match=f"lack the right ec2:{action}$"):
        desk.prepare()


def test_nobody_listens(open_desk: OpenDesk, tmp_path: Path) -> None:
    desk = open_desk("euca-5.1")
    desk.cloud.close()
    with pytest.raises(CloudError, match=r"cannot list .*check provider\.endpoint_url"):
        desk.provider.observe("bunny")


def test_another_path_answers(open_desk: OpenDesk) -> None:
    desk = open_desk("euca-5.1")
    port = desk.cloud.endpoint_url.split(":")[2].split("/")[0]
    with pytest.raises(CloudError, match=r"check provider\.endpoint_url"):
        desk.reopened(endpoint_url=f"http://127.0.0.1:{port}/services/wrong").observe("bunny")


class _WebPage(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(404)
        self.end_headers()
        self.wfile.write(b"<html><p>Nothing here</html>")

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


@pytest.fixture
def self_signed(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """Give an address behind a certificate that nobody knows, and that certificate's file."""
    with self_signed_server(tmp_path, _WebPage) as server:
        yield server


def test_an_unknown_certificate_is_never_accepted(
    open_desk: OpenDesk, self_signed: tuple[str, Path]
) -> None:
    url, certificate = self_signed
    desk = open_desk("euca-5.1")
    with pytest.raises(CloudError, match=r"provider\.ca_bundle"):
        desk.reopened(endpoint_url=url).observe("bunny")
    assert desk.waits == []
    # Known, it is passed: what is wrong then is that no EC2 answers there.
    with pytest.raises(CloudError, match="something other than EC2 answers"):
        desk.reopened(endpoint_url=url, ca_bundle=str(certificate)).observe("bunny")
