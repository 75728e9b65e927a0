"""Why AWS's own chain gives no keys, in one line: whose keys, what is wrong, what mends it."""

from __future__ import annotations

import getpass
import os
from collections.abc import Iterator, Mapping
from typing import Any

import botocore.exceptions as boto

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpcdeploy.providers.ec2.errors import NETWORK_ERRORS, translate

_EXPIRED = {"ExpiredToken", "ExpiredTokenException", "ExpiredTokenError"}


class MfaCodeError(Exception):
    """A code is wanted, and nobody can be asked for it."""


class NoKeysError(Exception):
    """No part of the chain has any keys."""


@dataclass(frozen=True, slots=True)
class Source:
    """Where keys come from.

    `profile` is the one that was asked for; None for the environment, and what it falls back to.
    `profiles` are all of AWS's files, and what each says.
    """

    profile: str | None
    profiles: Mapping[str, Mapping[str, object]]

    @classmethod
    def of(cls, session: Any, named: str | None) -> Source:
        """Return what a session of botocore has read; `named` is the cluster file's profile."""
        profile = named or os.environ.get("AWS_PROFILE") or os.environ.get("AWS_DEFAULT_PROFILE")
        return cls(profile, session.full_config.get("profiles", {}))

    def __str__(self) -> str:
        return f"profile {self.profile}" if self.profile else "the AWS keys of the environment"

    @property
    def option(self) -> str:
        """What chooses it on AWS's own command line."""
        return f" --profile {self.profile}" if self.profile else ""

    @property
    def settings(self) -> list[Mapping[str, object]]:
        """What its profile says, and each that this one builds on."""
        return list(self._chain())

    def _chain(self) -> Iterator[Mapping[str, object]]:
        name, seen = self.profile or "default", set[str]()
        while name in self.profiles and name not in seen:
            seen.add(name)
            yield self.profiles[name]
            name = str(self.profiles[name].get("source_profile", ""))

    def setting(self, key: str) -> str:
        """Return the first of its profiles' values of a key; empty where there is none."""
        return next((str(profile[key]) for profile in self.settings if key in profile), "")

    @property
    def asks_for_code(self) -> bool:
        """Whether somebody must type a code."""
        return bool(self.setting("mfa_serial"))


def explain_keys(error: Exception, source: Source, place: str) -> CloudError:
    """Return whatever the chain of keys raised as the one line that a user reads."""
    if isinstance(error, CloudError):
        return error
    what, advice = _explain(error, source)
    return CloudError(f"{place}: {source}: {what}", advice)


def _explain(error: Exception, source: Source) -> tuple[str, str]:
    """Tell what is wrong, and what mends it."""
    for explain in (_of_sso, _of_codes, _of_network, _of_roles, _of_process, _of_files):
        explained = explain(error, source)
        if explained is not None:
            return explained
    if isinstance(error, NoKeysError | boto.NoCredentialsError):
        return (
            "no keys, neither in AWS_ACCESS_KEY_ID nor in ~/.aws, and no machine's role answers",
            "run aws configure, set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or name "
            "provider.credentials",
        )
    if isinstance(error, boto.PartialCredentialsError):
        return _line(error), "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, both"
    return f"no keys ({type(error).__name__}: {_line(error)})", _by_hand(source)


Explained = tuple[str, str] | None


def _of_sso(error: Exception, source: Source) -> Explained:
    if isinstance(error, boto.SSOError | boto.TokenRetrievalError):
        start = source.setting("sso_session") or source.setting("sso_start_url")
        what = "has expired" if "xpired" in str(error) else "is missing or does not let it in"
        return (
            f"its SSO login at {start} {what} ({_line(error)})",
            f"run aws sso login{source.option}",
        )
    if isinstance(error, boto.LoginError):
        return f"its login {_line(error)}", f"run aws login{source.option}"
    return None


def _of_codes(error: Exception, source: Source) -> Explained:
    is_unasked = isinstance(error, MfaCodeError | EOFError | getpass.GetPassWarning)
    if not is_unasked and not isinstance(error, boto.RefreshWithMFAUnsupportedError):
        return None
    why = "nobody can be asked here" if is_unasked else "the last one's time is over"
    return (
        f"its role wants a code of MFA {source.setting('mfa_serial')}, and {why}",
        f"run aws sts get-caller-identity{source.option} in a terminal, which asks for it, "
        "then run this again",
    )


def _of_network(error: Exception, source: Source) -> Explained:
    if not isinstance(error, NETWORK_ERRORS):
        return None
    own_endpoints = sorted(name for name in os.environ if name.startswith("AWS_ENDPOINT_URL"))
    return (
        f"those who give its keys cannot be reached{_role(source)}: {_line(error)}",
        ", ".join(
            (
                "check the network, the proxy (HTTPS_PROXY, NO_PROXY)",
                "provider.region",
                *own_endpoints,
            )
        ),
    )


def _of_roles(error: Exception, source: Source) -> Explained:
    if isinstance(error, boto.ClientError):
        told = translate(error, f"get its keys{_role(source)}", "AWS")
        code = str(error.response.get("Error", {}).get("Code", ""))
        if code in _EXPIRED:
            return told.problem, f"renew the keys that it builds on{_by_source(source)}"
        if code.startswith(("AccessDenied", "Unauthorized")):
            return (
                told.problem,
                "let them do this: the role's trust policy, and sts:AssumeRole for "
                f"{source.setting('source_profile') or 'the keys that it builds on'}",
            )
        return told.problem, told.advice
    if isinstance(error, boto.CredentialRetrievalError) and "credential_source" in str(error):
        return (
            f"{_line(error)}: {source.setting('credential_source')} has none{_role(source)}",
            "run it on a machine that has a role, or name a source_profile instead",
        )
    if isinstance(error, boto.MetadataRetrievalError):
        return f"the machine's role cannot be asked for: {_line(error)}", _by_hand(source)
    return None


def _of_process(error: Exception, source: Source) -> Explained:
    command = source.setting("credential_process")
    is_its_own = isinstance(error, boto.CredentialRetrievalError | OSError | ValueError | KeyError)
    if not command or not is_its_own or isinstance(error, boto.InvalidConfigError):
        return None
    reason = _line(error).rpartition("custom-process: ")[2]
    if isinstance(error, ValueError):
        reason = "it does not print keys as JSON"
    return (
        f"its credential_process fails: {reason}",
        f"run it by hand, it may ask for something: {command}",
    )


def _of_files(error: Exception, source: Source) -> Explained:
    if isinstance(error, boto.ProfileNotFound):
        known = ", ".join(sorted(source.profiles)) or "none"
        return (
            f"there is no {source} in AWS's files (there: {known})",
            "check provider.credentials.profile and AWS_PROFILE; aws configure list-profiles "
            "shows them",
        )
    if isinstance(error, boto.ConfigParseError | boto.ConfigNotFound | boto.InvalidConfigError):
        return _line(error), f"mend {_config_file()}"
    if isinstance(error, OSError):
        if error.filename and str(error.filename) in (
            source.setting("web_identity_token_file"),
            os.environ.get("AWS_WEB_IDENTITY_TOKEN_FILE"),
        ):
            return (
                f"its web identity token {error.filename} cannot be read ({error.strerror})",
                "let whoever issues it write it anew, or mend web_identity_token_file",
            )
        named = f"{error.filename}: " if error.filename else ""
        return f"{named}{error.strerror or _line(error)}", "make it readable for you"
    return None


def _role(source: Source) -> str:
    role = source.setting("role_arn")
    return f" (for {role})" if role else ""


def _by_source(source: Source) -> str:
    name = source.setting("source_profile")
    if not name:
        return ""
    is_sso = any(key.startswith("sso_") for key in source.profiles.get(name, {}))
    return f": aws sso login --profile {name}" if is_sso else f", profile {name}"


def _by_hand(source: Source) -> str:
    return f"try aws sts get-caller-identity{source.option}, which uses the same keys"


def _config_file() -> str:
    return os.environ.get("AWS_CONFIG_FILE") or "~/.aws/config"


def _line(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".")[:400]
