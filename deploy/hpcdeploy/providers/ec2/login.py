"""The keys that AWS's own chain gives: asked for before a call, in bounded time, renewed.

::

    profile ─> SSO token ─> role (STS) ─> keys      each step may be missing, expired or silent
                  MFA code ──┘  └── credential_process, web identity, the machine's own role

botocore asks for them inside a call, so that a role that cannot be assumed looks like a cloud that
cannot be reached, and is asked for again with every try. `Login.check` asks beforehand, so that
what fails is known by its name.
"""

from __future__ import annotations

import os
import subprocess
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import boto3
import botocore.session
from botocore.config import Config
from botocore.credentials import ProcessProvider
from botocore.exceptions import BotoCoreError, CredentialRetrievalError
from botocore.utils import JSONFileCache

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpcdeploy.providers.ec2.credentials import CloudKeys
from hpcdeploy.providers.ec2.errors import is_lost_answer, is_throttled
from hpcdeploy.providers.ec2.key_errors import MfaCodeError, NoKeysError, Source, explain_keys

_RETRIES_S = (0.5, 1.0)
_SPENT = timedelta(minutes=15)  # botocore asks for another code so long before the end


@dataclass(frozen=True, slots=True)
class CloudTimeouts:
    """Bounds of time, in seconds, so that a question is answered or given up within half a minute.

    Parameters
    ----------
    connect_s : float
        Until a connection stands.
    keys_s : float
        Until those answer who give keys: STS, SSO; and within which they are asked again.
    process_s : float
        Until a ``credential_process`` has ended: it may ask a person for something.
    ask_s : float
        Until a question is answered; a cloud that has never answered is not asked again later.
    act_s : float
        Until a change is answered: a Eucalyptus may think about a launch for half a minute.
    """

    connect_s: float = 8.0
    keys_s: float = 8.0
    process_s: float = 20.0
    ask_s: float = 16.0
    act_s: float = 60.0


class Login:
    """A session of boto3, and the keys of its profile.

    A role is assumed in `region`, if its profile does not say where. Raises CloudError where the
    profile does not exist, or its file cannot be read.
    """

    def __init__(self, keys: CloudKeys, region: str, place: str, timeouts: CloudTimeouts) -> None:
        self._keys, self._timeouts, self._place = keys, timeouts, place
        self._core = botocore.session.Session(profile=keys.profile)
        self._core.set_default_client_config(
            Config(
                connect_timeout=timeouts.connect_s,
                read_timeout=timeouts.keys_s,
                retries={"mode": "standard", "total_max_attempts": 1},  # `check` repeats
            )
        )
        try:
            self._core.set_config_variable("region", region)
            self._prepare()
            self._session = boto3.session.Session(botocore_session=self._core)
        except Exception as error:  # the chain raises whatever its parts raise
            raise self._explained(error) from error

    def client(self, service: str, **settings: Any) -> Any:
        """Return a client; before each of its calls the keys are seen to."""
        self.check()
        client = self._session.client(service, **settings)
        client.meta.events.register_first("before-call", lambda **_about: self.check())
        return client

    def check(self) -> None:
        """Have the keys at hand, and renew those that are about to expire.

        Raises CloudError where there are none; it says whose, why and which command mends it.
        """
        if self._keys.access_key is not None:
            return
        deadline = time.monotonic() + self._timeouts.keys_s
        for wait_s in (*_RETRIES_S, None):
            try:
                credentials = self._core.get_credentials()
                if credentials is None:
                    raise NoKeysError
                credentials.get_frozen_credentials()
                return
            except Exception as error:  # the chain raises whatever its parts raise
                passes = is_lost_answer(error) or is_throttled(error)
                if not passes or wait_s is None or time.monotonic() + wait_s >= deadline:
                    raise self._explained(error) from error
            time.sleep(wait_s)

    def _prepare(self) -> None:
        """Bound what a chain may run, and let codes be shared with the AWS command line."""
        chain = self._core.get_component("credential_provider")
        name = self._core.get_config_variable("profile") or "default"
        bounded = ProcessProvider(name, lambda: self._core.full_config, popen=self._start)
        chain.insert_after(ProcessProvider.METHOD, bounded)
        chain.remove(ProcessProvider.METHOD)  # the first of that name: botocore's own
        if self._source().asks_for_code:
            folder = str(Path("~/.aws/cli/cache").expanduser())
            cache = JSONFileCache(folder) if _has_terminal() else _KnownCodes(folder)
            chain.get_provider("assume-role").cache = cache

    def _start(self, command: list[str], **pipes: Any) -> _BoundedProcess:
        return _BoundedProcess(command, self._timeouts.process_s, **pipes)

    def _source(self) -> Source:
        return Source.of(self._core, self._keys.profile)

    def _explained(self, error: Exception) -> CloudError:
        try:
            source = self._source()
        except Exception:  # the very files cannot be read: `error` says it
            source = Source(self._keys.profile, {})
        return explain_keys(error, source, self._place)


def default_region() -> str:
    """Return the region of the environment, or of its profile; empty where neither says it.

    Raises CloudError where AWS's files cannot be read, or do not have the profile.
    """
    core = botocore.session.Session()
    try:
        return core.get_config_variable("region") or ""
    except BotoCoreError as error:
        raise explain_keys(error, Source(os.environ.get("AWS_PROFILE"), {}), "aws") from error


class _BoundedProcess(subprocess.Popen[bytes]):
    """A ``credential_process`` that is ended when it takes too long."""

    def __init__(self, command: list[str], limit_s: float, **pipes: Any) -> None:
        super().__init__(command, **pipes)
        self._limit_s = limit_s

    def communicate(self, input: Any = None, timeout: float | None = None) -> tuple[Any, Any]:  # noqa: A002
        """Wait for its end."""
        try:
            return super().communicate(input, timeout or self._limit_s)
        except subprocess.TimeoutExpired:
            self.kill()
            for pipe in (self.stdout, self.stderr):  # a child of its own may hold the other end
                if pipe is not None:
                    pipe.close()
            self.wait()
            raise CredentialRetrievalError(
                provider=ProcessProvider.METHOD,
                error_msg=f"it did not end within {self._limit_s:g} s",
            ) from None


class _KnownCodes(JSONFileCache):  # type: ignore[misc]  # botocore has no types
    """Roles that were assumed with a code before; where nobody can be asked, no others."""

    def __contains__(self, key: str) -> bool:
        try:
            until = datetime.fromisoformat(self[key]["Credentials"]["Expiration"])
        except (KeyError, TypeError, ValueError):
            raise MfaCodeError from None
        if until.astimezone(UTC) <= datetime.now(UTC) + _SPENT:
            raise MfaCodeError
        return True


def _has_terminal() -> bool:
    """Tell whether somebody can be asked: as `getpass` does it."""
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY))
    except OSError:
        return False
    return True
