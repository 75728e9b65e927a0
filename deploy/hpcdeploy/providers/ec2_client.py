"""Clients of boto3, and calls that are repeated where that is of use."""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import boto3
from botocore.config import Config
from botocore.exceptions import BotoCoreError

from hpccomponent.errors import CloudError
from hpccomponent.paths import expand_home
from hpcdeploy.provider_spec import CloudSpec
from hpcdeploy.providers.ec2_capabilities import capabilities_of
from hpcdeploy.providers.ec2_credentials import find_keys
from hpcdeploy.providers.ec2_errors import (
    BOTO_ERRORS,
    code_of,
    is_lost_answer,
    is_throttled,
    translate,
)

__all__ = ["Calls", "cloud_name", "open_client"]

CONNECT_S = 10.0
READ_S = 60.0  # a Eucalyptus may think about a launch for half a minute
ATTEMPTS = 5
FIRST_WAIT_S = 0.5  # doubled each time: 7.5 s at most in all


def cloud_name(cloud: CloudSpec) -> str:
    """Return what users call their cloud."""
    return f"{cloud.type} ({cloud.endpoint_url or cloud.region})"


def open_client(service: str, cloud: CloudSpec, base: Path) -> Any:
    """Return a client of boto3 for a cloud.

    Parameters
    ----------
    service : str
        ``ec2`` or ``s3``.
    cloud : CloudSpec
    base : Path
        The folder of the cluster file.

    Raises
    ------
    CloudError
        Keys or endpoint are not to be found.
    """
    keys = find_keys(cloud, base, os.environ)
    if service == "ec2":
        endpoint = cloud.endpoint_url or keys.ec2_url
        version = capabilities_of(cloud).api_version
    else:
        endpoint, version = cloud.s3_endpoint_url or keys.s3_url, None
    if endpoint is None and cloud.type != "aws":
        key = "endpoint_url" if service == "ec2" else "s3_endpoint_url"
        raise CloudError(f"{cloud.type}: no endpoint of {service} is known", f"set provider.{key}")
    ca_bundle = cloud.ca_bundle or keys.ca_bundle
    region = cloud.signing_region or (cloud.region if cloud.type == "aws" else "eucalyptus")
    try:
        session = boto3.session.Session(profile_name=keys.profile)
        return session.client(
            service,
            region_name=region,
            endpoint_url=endpoint,
            api_version=version,
            verify=str(base / expand_home(ca_bundle)) if ca_bundle else None,
            aws_access_key_id=keys.access_key,
            aws_secret_access_key=keys.secret_key,
            aws_session_token=keys.token,
            config=_config(service),
        )
    except (BotoCoreError, ValueError) as error:
        raise translate(error, "open a connection", cloud_name(cloud)) from error


def _config(service: str) -> Config:
    common = {"connect_timeout": CONNECT_S, "read_timeout": READ_S}
    if service == "ec2":
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

    Repeating is safe for each call that we make: launches carry a token, and what is there or
    gone already is taken as done by the callers.

    Parameters
    ----------
    client : EC2 client of boto3
    place : str
        The cloud, as the user calls it.
    sleep : callable
        Replaced in tests.
    """

    def __init__(
        self, client: Any, place: str, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._client = client
        self._place = place
        self._sleep = sleep

    def call(
        self,
        operation: str,
        doing: str,
        *,
        not_yet: Collection[str] = (),
        **parameters: Any,
    ) -> dict[str, Any]:
        """Make a call.

        Parameters
        ----------
        operation : str
            In boto3's spelling: ``run_instances``.
        doing : str
            What it is for, in the words of an error.
        not_yet : collection of str
            Codes that a cloud gives until it has noticed its own last change: waited out.

        Raises
        ------
        CloudError
            `code_of` tells the cloud's own code.
        """
        for is_last in self.tries():
            try:
                reply: dict[str, Any] = getattr(self._client, operation)(**parameters)
                return reply
            except BOTO_ERRORS as error:
                passes = is_throttled(error) or is_lost_answer(error) or code_of(error) in not_yet
                if not passes or is_last:
                    raise translate(error, doing, self._place) from error
        raise AssertionError("the last try returns or raises")

    def tries(self) -> Iterator[bool]:
        """Yield as often as something is tried, waiting in between; True for the last time."""
        wait = FIRST_WAIT_S
        for _ in range(1, ATTEMPTS):
            yield False
            self._sleep(wait * random.uniform(0.5, 1.0))  # noqa: S311 - spreads clients, no secret
            wait *= 2
        yield True

    def all_of(self, operation: str, key: str, doing: str, **parameters: Any) -> list[Any]:
        """Return all entries of a list, page by page."""
        found: list[Any] = []
        while True:
            reply = self.call(operation, doing, **parameters)
            found.extend(reply.get(key, []))
            if not reply.get("NextToken"):
                return found
            parameters = {**parameters, "NextToken": reply["NextToken"]}
