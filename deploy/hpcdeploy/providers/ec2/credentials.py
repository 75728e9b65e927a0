"""The keys of a cloud, from where people have them: AWS's chain, euca2ools, eucarc, environment."""

from __future__ import annotations

import configparser
import re
import shlex
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpccomponent.files.paths import expand_home
from hpcdeploy.spec.provider import CloudSpec


@dataclass(frozen=True, slots=True)
class CloudKeys:
    """How to get into a cloud.

    Keys and token are None for AWS's own chain: environment, ``~/.aws``, the machine's role.
    `profile` is of ``~/.aws``; addresses and `ca_bundle` are what the keys' own file names: the
    cluster file overrules.
    """

    access_key: str | None = None
    secret_key: str | None = field(default=None, repr=False)
    token: str | None = field(default=None, repr=False)
    profile: str | None = None
    ec2_url: str | None = None
    s3_url: str | None = None
    ca_bundle: str | None = None


def find_keys(cloud: CloudSpec, base: Path, environment: Mapping[str, str]) -> CloudKeys:
    """Return the keys that a cluster file asks for; empty where boto3 is to find them by itself.

    `environment` is looked into where the file names no place. Raises CloudError where a file
    cannot be read, or names no keys.
    """
    named = cloud.credentials
    if named.profile is not None:
        return CloudKeys(profile=named.profile)
    if named.euca_ini is not None:
        return _read_ini(base / expand_home(named.euca_ini), cloud.region)
    if named.eucarc is not None:
        path = base / expand_home(named.eucarc)
        keys = _from_variables(_read_eucarc(path))
        if keys.access_key is None or keys.secret_key is None:
            raise CloudError(
                f"{path}: it exports no keys", "AWS_ACCESS_KEY and AWS_SECRET_KEY are looked for"
            )
        return keys
    return CloudKeys() if cloud.is_known_to_boto3 else _from_variables(environment)


def _from_variables(variables: Mapping[str, str]) -> CloudKeys:
    def first(*names: str) -> str | None:
        return next((variables[name] for name in names if variables.get(name)), None)

    return CloudKeys(
        access_key=first("AWS_ACCESS_KEY_ID", "AWS_ACCESS_KEY", "EC2_ACCESS_KEY"),
        secret_key=first("AWS_SECRET_ACCESS_KEY", "AWS_SECRET_KEY", "EC2_SECRET_KEY"),
        token=first("AWS_SESSION_TOKEN", "AWS_SECURITY_TOKEN"),
        ec2_url=first("EC2_URL"),
        s3_url=first("S3_URL"),
        ca_bundle=first("EUCALYPTUS_CERT"),
    )


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CloudError(
            f"{path}: cannot be read ({error})", "name a file of credentials that you may read"
        ) from error


_EXPORT = re.compile(r"^\s*(?:export\s+)?([A-Z]\w*)=(.*)$")


def _read_eucarc(path: Path) -> dict[str, str]:
    """Read the exports of a shell file without running it."""
    # Its first line asks a shell for the folder that it is in; all later ones build on that.
    variables = {"EUCA_KEY_DIR": str(path.parent.absolute())}
    for line in _read_text(path).splitlines():
        match = _EXPORT.match(line)
        if match is None or "$(" in match[2] or "`" in match[2]:
            continue
        try:
            words = shlex.split(match[2], comments=True)
        except ValueError as error:
            raise CloudError(f"{path}: {match[1]} is no shell text ({error})") from error
        value = words[0] if words else ""
        variables[match[1]] = re.sub(r"\$\{?(\w+)\}?", lambda m: variables.get(m[1], ""), value)
    return variables


def _read_ini(path: Path, region: str) -> CloudKeys:
    """Read a file of euca2ools: ``[user ACCOUNT:NAME]``, ``[region NAME]``, ``[global]``."""
    ini = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        ini.read_string(_read_text(path))
    except configparser.Error as error:
        raise CloudError(f"{path}: {' '.join(str(error).split())}") from error
    regions = _sections(ini, "region")
    defaults = dict(ini["global"]) if ini.has_section("global") else {}
    place = regions.get(region) or regions.get(defaults.get("default-region", "")) or {}
    if not place and len(regions) == 1:
        place = next(iter(regions.values()))
    users = _sections(ini, "user")
    name = place.get("user") or defaults.get("default-user", "")
    user = users.get(name) or (next(iter(users.values())) if len(users) == 1 else {})
    if not user.get("key-id") or not user.get("secret-key"):
        raise CloudError(
            f"{path}: no keys for region {region!r} (users: {', '.join(users) or 'none'})",
            'say which by "user = ACCOUNT:NAME" in its region',
        )
    return CloudKeys(
        access_key=user["key-id"],
        secret_key=user["secret-key"],
        ec2_url=place.get("ec2-url"),
        s3_url=place.get("s3-url"),
        ca_bundle=place.get("certificate"),
    )


def _sections(ini: configparser.ConfigParser, kind: str) -> dict[str, dict[str, str]]:
    return {
        section.split(maxsplit=1)[1].strip(): dict(ini[section])
        for section in ini.sections()
        if section.startswith(kind + " ")
    }
