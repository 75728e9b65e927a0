"""moto's EC2 backend of one cloud of a test: an account of its own, and one image."""

from __future__ import annotations

import os
import secrets
from datetime import datetime
from typing import Any
from unittest import mock

from moto.ec2.models import ec2_backends
from moto.ec2.models.amis import Ami
from moto.s3.models import s3_backends

from cloud.instances import Instance

REGION = "us-east-1"


class Model:
    """What exists."""

    def __init__(self, profile: str) -> None:
        self.account = str(100_000_000_000 + secrets.randbelow(900_000_000_000))
        with mock.patch.dict(os.environ, MOTO_EC2_LOAD_DEFAULT_AMIS="false"):
            self.backend: Any = ec2_backends[self.account][REGION]
        prefix = "emi" if profile.startswith("euca") else "ami"
        self.image_id = f"{prefix}-0123456789abcdef0"
        self.image_ids: set[str] = set()
        self.add_image(self.image_id, "debian-12", datetime(2024, 1, 1))
        self.instances: dict[str, Instance] = {}

    def add_image(self, image_id: str, name: str, created: datetime) -> None:
        """Register an image of this account."""
        self.image_ids.add(image_id)
        known_to_moto = image_id.replace("emi-", "ami-")
        self.backend.amis[known_to_moto] = Ami(
            self.backend,
            known_to_moto,
            owner_id=self.account,
            creation_date=created,
            name=name,
            public=True,
            virtualization_type="hvm",
            architecture="x86_64",
            root_device_type="ebs",
            root_device_name="/dev/xvda",
        )

    def groups(self) -> list[Any]:
        """All security groups that are not called default."""
        return [
            group
            for groups in self.backend.groups.values()
            for group in groups.values()
            if group.name != "default"
        ]

    def default_subnet(self, zone: str | None) -> str:
        """Return the id of the subnet that is taken where none is named."""
        subnets = self.backend.get_default_subnets()
        return str(subnets[zone if zone in subnets else min(subnets)].id)

    def close(self) -> None:
        """Forget all of it."""
        ec2_backends.pop(self.account, None)
        s3_backends.pop(self.account, None)
        owners = s3_backends.bucket_accounts  # bucket names are shared by all accounts
        for bucket in [name for name, (_, account) in owners.items() if account == self.account]:
            del owners[bucket]
