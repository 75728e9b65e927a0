"""Clients of boto3, and calls that are repeated where that is of use."""

from __future__ import annotations

import os
import random
import threading
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from botocore.config import Config
from botocore.exceptions import BotoCoreError, ClientError

from hpccomponent.errors import CloudError
from hpccomponent.files.paths import expand_home
from hpcdeploy.providers.ec2.capabilities import capabilities_of
from hpcdeploy.providers.ec2.credentials import find_keys
from hpcdeploy.providers.ec2.errors import (
    BOTO_ERRORS,
    code_of,
    has_expired,
    is_lost_answer,
    is_throttled,
    translate,
)
from hpcdeploy.providers.ec2.login import CloudTimeouts, Login
from hpcdeploy.spec.provider import CloudSpec

Client = Any
"""A client of boto3, which makes its methods at run time from Amazon's description."""
Described = dict[str, Any]
"""What a cloud replies, or a part of it, as Amazon's description has it."""
Parameters = dict[str, Any]
"""What a call is given."""
ATTEMPTS = 5
MOST_PAGES = 1000  # of a list
FIRST_WAIT_S = 0.5  # doubled each time: 7.5 s at most in all


def cloud_name(cloud: CloudSpec) -> str:
    """Return what users call their cloud."""
    return f"{cloud.type} ({cloud.endpoint_url or cloud.region})"


def open_client(
    service: str, cloud: CloudSpec, base: Path, timeouts: CloudTimeouts | None = None
) -> Client:
    """Return a client of boto3 for a cloud's service ``ec2``, ``s3`` or ``ssm``."""
    clients = _Clients(cloud, base, timeouts or CloudTimeouts())
    return clients.client(service, clients.timeouts.act_s)


def open_calls(
    cloud: CloudSpec,
    base: Path,
    timeouts: CloudTimeouts | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> Calls:
    """Return the calls of a cloud's EC2; see `open_client` for the rest.

    Where its keys have expired in mid-work, those that lie where they came from are taken.
    """
    clients = _Clients(cloud, base, timeouts or CloudTimeouts())
    return Calls(
        clients.asking(),
        cloud_name(cloud),
        sleep,
        acting=clients.acting,
        renew=clients.renew,
        first_s=clients.timeouts.ask_s,
    )


def read_parameter(cloud: CloudSpec, base: Path, name: str) -> str:
    """Return the value of a parameter in the parameter store (SSM).

    Raises CloudError where there is none, or it must not be read.
    """
    client = open_client("ssm", cloud, base)
    try:
        return str(client.get_parameter(Name=name)["Parameter"]["Value"])
    except (BotoCoreError, ClientError) as error:
        raise translate(error, f"read the parameter {name}", cloud_name(cloud)) from error
    finally:
        client.close()


class _Clients:
    """The clients of one login: for questions, whose answers come soon, and for changes."""

    def __init__(self, cloud: CloudSpec, base: Path, timeouts: CloudTimeouts) -> None:
        self._cloud, self._base, self.timeouts = cloud, base, timeouts
        self._lock = threading.Lock()
        self._login: Login | None = None
        self._acting: Client = None

    def asking(self) -> Client:
        """Return a client for questions."""
        return self.client("ec2", self.timeouts.ask_s)

    def acting(self) -> Client:
        """Return the client for changes."""
        with self._lock:
            if self._acting is None:
                self._acting = self.client("ec2", self.timeouts.act_s)
            return self._acting

    def renew(self) -> Client:
        """Read the keys anew; return another client for questions."""
        with self._lock:
            self._login = self._acting = None
            return self.asking()

    def client(self, service: str, read_s: float) -> Client:
        """Return a client; the first one logs in."""
        cloud, keys = self._cloud, find_keys(self._cloud, self._base, os.environ)
        if service == "ec2":
            endpoint = cloud.endpoint_url or keys.ec2_url
            version = capabilities_of(cloud).api_version
        elif service == "s3":
            endpoint, version = cloud.s3_endpoint_url or keys.s3_url, None
        else:  # a service of Amazon's alone, at its own address
            endpoint = version = None
        if endpoint is None and not cloud.is_known_to_boto3:
            key = "endpoint_url" if service == "ec2" else "s3_endpoint_url"
            raise CloudError(
                f"{cloud.type}: no endpoint of {service} is known", f"set provider.{key}"
            )
        certificates = _certificates(cloud.ca_bundle or keys.ca_bundle, self._base)
        region = cloud.signed_region
        if self._login is None:
            self._login = Login(keys, region, cloud_name(cloud), self.timeouts)
        try:
            return self._login.client(
                service,
                region_name=region,
                endpoint_url=endpoint,
                api_version=version,
                verify=certificates,
                aws_access_key_id=keys.access_key,
                aws_secret_access_key=keys.secret_key,
                aws_session_token=keys.token,
                config=_config(service, self.timeouts.connect_s, read_s),
            )
        except (BotoCoreError, ValueError) as error:
            raise translate(error, "open a connection", cloud_name(cloud)) from error


def _certificates(named: str | None, base: Path) -> str | None:
    """Return the file of certificates to check the cloud's by; None for the system's own.

    Raises CloudError where it is not there, be it boto3's own.
    """
    path = base / expand_home(named) if named else None
    name = next((n for n in ("AWS_CA_BUNDLE", "REQUESTS_CA_BUNDLE") if os.environ.get(n)), "")
    bundle = path or (Path(os.environ[name]) if name else None)
    if bundle is not None and not bundle.exists():
        raise CloudError(
            f"{bundle}: there is no such file of certificates",
            f"check {'provider.ca_bundle' if named else name}",
        )
    return str(path) if path else None


def _config(service: str, connect_s: float, read_s: float) -> Config:
    common = {"connect_timeout": connect_s, "read_timeout": read_s}
    if service != "s3":
        # Once only: boto3 repeats a launch that found no capacity as well, since Amazon answers
        # it with 500, and cannot be told not to. `Calls` repeats instead.
        return Config(retries={"mode": "standard", "total_max_attempts": 1}, **common)
    return Config(
        retries={"mode": "standard", "total_max_attempts": 4},
        s3={"addressing_style": "path"},
        request_checksum_calculation="when_required",  # other stores know no trailing checksums
        response_checksum_validation="when_required",
        **common,
    )


class Calls:
    """Calls of EC2, repeated with growing waits, their errors translated.

    Repeating is safe for each call that we make: launches carry a token, and what is there or gone
    already is taken as done by the callers.

    `acting` returns the client for changes, which waits longer for its answers; `renew` another
    client, with the keys that are there by now. Until the cloud has answered once, it is not asked
    again after `first_s` seconds.
    """

    def __init__(
        self,
        client: Client,
        place: str,
        sleep: Callable[[float], None] = time.sleep,
        *,
        acting: Callable[[], Client] | None = None,
        renew: Callable[[], Client] | None = None,
        first_s: float = float("inf"),
    ) -> None:
        self._client = client
        self._place = place
        self._sleep = sleep
        self._acting = acting
        self._renew = renew
        self._first_s = first_s
        self._has_answered = False

    def call(
        self,
        operation: str,
        doing: str,
        *,
        not_yet: Collection[str] = (),
        **parameters: Any,
    ) -> Described:
        """Make a call; `operation` is in boto3's spelling: ``run_instances``.

        Codes in `not_yet`, which a cloud gives until it has noticed its own last change, are waited
        out. Raises CloudError, of which `code_of` tells the cloud's own code.
        """
        is_renewed = False
        deadline = time.monotonic() + self._first_s
        for is_last in self.tries():
            try:
                return self._ask(operation, parameters)
            except (*BOTO_ERRORS, CloudError) as error:
                if has_expired(error) and self._renew is not None and not (is_renewed or is_last):
                    self._client, is_renewed = self._renew(), True
                    continue
                if isinstance(error, CloudError):  # of the keys, and said in our words
                    raise
                passes = is_throttled(error) or is_lost_answer(error) or code_of(error) in not_yet
                is_late = not self._has_answered and time.monotonic() >= deadline
                if not passes or is_last or is_late:
                    raise translate(error, doing, self._place) from error
        raise AssertionError("the last try returns or raises")

    def _ask(self, operation: str, parameters: Parameters) -> Described:
        is_question = operation.startswith(("describe_", "get_"))
        client = self._client if is_question or self._acting is None else self._acting()
        try:
            reply: Described = getattr(client, operation)(**parameters)
        except ClientError:
            self._has_answered = True
            raise
        self._has_answered = True
        return reply

    def tries(self) -> Iterator[bool]:
        """Yield as often as something is tried, waiting in between; True for the last time."""
        wait = FIRST_WAIT_S
        for _ in range(1, ATTEMPTS):
            yield False
            self._sleep(wait * random.uniform(0.5, 1.0))  # noqa: S311 - spreads clients, no secret
            wait *= 2
        yield True

    def all_of(self, operation: str, key: str, doing: str, **parameters: Any) -> list[Described]:
        """Return all entries of a list, page by page; `key` names the list in each reply."""
        entries: list[Described] = []
        tokens: set[str] = set()
        while True:
            reply = self.call(operation, doing, **parameters)
            entries.extend(reply.get(key, []))
            token = reply.get("NextToken")
            if not token:
                return entries
            if token in tokens or len(tokens) == MOST_PAGES:
                problem = f"{self._place}: cannot {doing}: its list has no end"
                raise CloudError(problem, "ask the cloud's operator")
            tokens.add(token)
            parameters = {**parameters, "NextToken": token}
