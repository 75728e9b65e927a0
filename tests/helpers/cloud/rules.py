"""How clouds behave where moto does not: one function for each action that differs."""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from xml.sax.saxutils import escape

from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.serialization import load_ssh_public_key

from cloud.instances import Instance
from cloud.model import Model

Answer = tuple[str, list[tuple[str, str]], bytes]
Parameters = dict[str, str]
Moto = Callable[[Parameters], Answer]

XML = [("Content-Type", "text/xml")]
USER_DATA_LIMIT = 16384
TYPES = re.compile(r"^[a-z]\w*\.(nano|micro|small|medium|large|\d*xlarge|metal)$")


def _is_common_rsa(key: bytes) -> bool:
    if not key.startswith(b"ssh-rsa "):
        return False
    loaded = load_ssh_public_key(key)
    return isinstance(loaded, RSAPublicKey) and loaded.key_size in (1024, 2048, 4096)


class RefusedError(Exception):
    """An error as EC2 answers it."""

    def __init__(self, code: str, message: str, status: int = 400) -> None:
        super().__init__(code, message, status)
        self.code, self.message, self.status = code, message, status

    def answer(self) -> Answer:
        body = (
            f"<Response><Errors><Error><Code>{escape(self.code)}</Code><Message>"
            f"{escape(self.message)}</Message></Error></Errors><RequestID>r</RequestID></Response>"
        )
        return f"{self.status} Error", XML, body.encode()


class Rules:
    """The behaviour of one cloud."""

    def __init__(
        self,
        model: Model,
        profile: str,
        pending: int | None,
        lag: int,
        list_lag: int,
        has_vpc: bool,
    ) -> None:
        self._model = model
        self._is_aws = profile == "aws"
        self._is_eucalyptus = profile.startswith("euca")
        self._pending, self._lag, self._list_lag = pending, lag, list_lag
        self._has_vpc = has_vpc
        self._tokens: dict[str, tuple[Parameters, str, Answer]] = {}

    def act(self, action: str, parameters: Parameters, moto: Moto) -> Answer:
        """Do what a call asks for; `moto` does it for the parameters that it is given."""
        if not self._has_vpc and ("Vpc" in action or "Subnet" in action):
            raise RefusedError("InvalidAction", f"{action} is not available in this cloud")
        rule = getattr(self, "_" + action, None)
        answer: Answer = rule(parameters, moto) if rule is not None else moto(parameters)
        return answer

    # instances ----------------------------------------------------------------------------

    def _RunInstances(self, parameters: Parameters, moto: Moto) -> Answer:  # noqa: N802
        token = parameters.get("ClientToken", "")
        if token in self._tokens and parameters.get("DryRun") != "true":
            return self._repeated(token, parameters)
        self._check_launch(parameters)
        changed = dict(parameters)
        subnet = "SubnetId"
        if "NetworkInterface.1.DeviceIndex" in parameters:
            subnet = "NetworkInterface.1.SubnetId"
        if subnet not in parameters:
            zone = parameters.get("Placement.AvailabilityZone")
            changed[subnet] = self._model.default_subnet(zone)
        before = set(self._model.backend.reservations)
        status, headers, body = moto(changed)
        for reservation in set(self._model.backend.reservations) - before:
            for found in self._model.backend.reservations[reservation].instances:
                instance = Instance(found, self._is_aws, token)
                instance.ticks = self._pending
                instance.unseen, instance.unlisted = self._lag, self._list_lag
                self._model.instances[instance.id] = instance
                if token:
                    self._tokens[token] = (parameters, instance.id, (status, headers, body))
        return status, headers, body

    def _repeated(self, token: str, parameters: Parameters) -> Answer:
        first, instance_id, (status, headers, body) = self._tokens[token]
        if first != parameters:
            raise RefusedError(
                "IdempotentParameterMismatch", "the client token was used with other parameters"
            )
        state = self._model.instances[instance_id]._model._state
        now = f"<instanceState><code>{state.code}</code><name>{state.name}</name></instanceState>"
        body = re.sub(rb"<instanceState>.*?</instanceState>", now.encode(), body, flags=re.S)
        return status, headers, body

    def _check_launch(self, parameters: Parameters) -> None:
        if (parameters.get("MinCount"), parameters.get("MaxCount")) != ("1", "1"):
            raise RefusedError("InvalidParameterValue", "the front launches one at a time")
        try:
            size = len(base64.b64decode(parameters.get("UserData", ""), validate=True))
        except binascii.Error:
            raise RefusedError("InvalidUserData.Malformed", "user data is not base64") from None
        if size > USER_DATA_LIMIT:
            raise RefusedError("InvalidParameterValue", "User data is limited to 16384 bytes")
        if parameters.get("ImageId") not in self._model.image_ids:
            raise RefusedError("InvalidAMIID.NotFound", f"The image id {parameters.get('ImageId')}")
        if not TYPES.match(parameters.get("InstanceType", "")):
            raise RefusedError("InvalidParameterValue", "Invalid value for InstanceType")
        if parameters.get("KeyName") not in {None, *self._model.backend.key_pairs}:
            raise RefusedError("InvalidKeyPair.NotFound", f"The key pair {parameters['KeyName']}")
        if len(parameters.get("ClientToken", "")) > 64:
            raise RefusedError("InvalidParameterValue", "ClientToken is limited to 64 characters")
        kinds = [v for k, v in parameters.items() if k.endswith(".ResourceType")]
        if (
            "spot-instances-request" in kinds
            and "InstanceMarketOptions.MarketType" not in parameters
        ):
            raise RefusedError(
                "InvalidParameterValue", "'spot-instances-request' is not valid here"
            )
        if not {*kinds} <= {"instance", "volume", "network-interface", "spot-instances-request"}:
            raise RefusedError("InvalidParameterValue", f"{kinds} are not valid for a launch")
        if "NetworkInterface.1.DeviceIndex" in parameters and (
            "SubnetId" in parameters or "SecurityGroupId.1" in parameters
        ):
            raise RefusedError(
                "InvalidParameterCombination", "Network interfaces and an instance-level subnet ID"
            )

    def _DescribeInstances(self, parameters: Parameters, moto: Moto) -> Answer:  # noqa: N802
        named = [value for name, value in parameters.items() if name.startswith("InstanceId.")]
        for instance_id in named:
            self._find(instance_id)
        filters = _filters(parameters)
        shown = []
        for instance in self._model.instances.values():
            if named and instance.id not in named:
                continue
            if not named and instance.unlisted > 0:
                instance.unlisted -= 1
                continue
            instance.tick()
            if all(_passes(instance, name, values) for name, values in filters.items()):
                shown.append(instance)
        with self._only({instance.id for instance in shown}):
            rest = {n: v for n, v in parameters.items() if n in ("MaxResults", "NextToken")}
            return moto(rest)

    def _TerminateInstances(self, parameters: Parameters, moto: Moto) -> Answer:  # noqa: N802
        named = [value for name, value in parameters.items() if name.startswith("InstanceId.")]
        before = [(instance, instance.state) for instance in map(self._find, named)]
        answer = moto(parameters)
        for instance, state in before:
            instance.end(state, self._pending)
        return answer

    def _CreateTags(self, parameters: Parameters, moto: Moto) -> Answer:  # noqa: N802
        for name, value in parameters.items():
            if name.startswith("ResourceId.") and value.startswith("i-"):
                self._find(value)
        return moto(parameters)

    def _GetConsoleOutput(self, parameters: Parameters, moto: Moto) -> Answer:  # noqa: N802
        text = self._find(parameters["InstanceId"]).console
        output = base64.b64encode(text.encode()[-65536:]).decode()
        body = (
            f"<GetConsoleOutputResponse><instanceId>{parameters['InstanceId']}</instanceId>"
            f"<output>{output}</output></GetConsoleOutputResponse>"
        )
        return "200 OK", XML, body.encode()

    def _DescribeImages(self, parameters: Parameters, moto: Moto) -> Answer:  # noqa: N802
        named = {v for name, v in parameters.items() if name.startswith("ImageId.")}
        if named - self._model.image_ids:
            raise RefusedError("InvalidAMIID.NotFound", f"The image ids {sorted(named)}")
        changed = {name: value.replace("emi-", "ami-") for name, value in parameters.items()}
        status, headers, body = moto(changed)
        own = self._model.image_id[:4].encode()
        body = body.replace(b"ami-", own)
        # As nearly all images have it; moto's would leave a volume behind for every instance.
        ends = b"<deleteOnTermination>%b</deleteOnTermination>"
        return status, headers, body.replace(ends % b"false", ends % b"true")

    def _find(self, instance_id: str) -> Instance:
        instance = self._model.instances.get(instance_id)
        if instance is None or instance.unseen > 0:
            if instance is not None:
                instance.unseen -= 1
            raise RefusedError(
                "InvalidInstanceID.NotFound", f"The instance ID '{instance_id}' does not exist"
            )
        return instance

    @contextmanager
    def _only(self, shown: set[str]) -> Iterator[None]:
        """Let moto see these instances only."""
        backend = self._model.backend
        everything = backend.reservations
        backend.reservations = type(everything)(
            (key, reservation)
            for key, reservation in everything.items()
            if any(instance.id in shown for instance in reservation.instances)
        )
        try:
            yield
        finally:
            backend.reservations = everything

    # key pairs and groups -----------------------------------------------------------------

    def _ImportKeyPair(self, parameters: Parameters, moto: Moto) -> Answer:  # noqa: N802
        key = base64.b64decode(parameters["PublicKeyMaterial"])
        if not (self._is_aws or _is_common_rsa(key)):
            raise RefusedError("InvalidKey.Format", "Invalid or unsupported key format")
        return moto(parameters)

    def _AuthorizeSecurityGroupIngress(  # noqa: N802
        self, parameters: Parameters, moto: Moto
    ) -> Answer:
        protocols = [v for n, v in parameters.items() if n.endswith(".IpProtocol")]
        if not self._has_vpc and not set(protocols) <= {"tcp", "udp", "icmp"}:
            raise RefusedError("InvalidPermission.Malformed", "Invalid protocol")
        status, headers, body = moto(parameters)
        if self._is_eucalyptus and b"InvalidPermission.Duplicate" in body:
            # One rule that exists, and none of the call's is added; nor is it an error.
            name = b"AuthorizeSecurityGroupIngressResponse"
            return "200 OK", XML, b"<%b><return>false</return></%b>" % (name, name)
        return status, headers, body

    def _DeleteSecurityGroup(self, parameters: Parameters, moto: Moto) -> Answer:  # noqa: N802
        group_id = parameters.get("GroupId")
        for instance in self._model.instances.values():
            ids = {group.id for group in instance._model.security_groups}
            if group_id in ids and instance.state != "terminated":
                code = "DependencyViolation" if self._has_vpc else "InvalidGroup.InUse"
                raise RefusedError(code, f"resource {group_id} has a dependent object")
        return moto(parameters)

    def _DescribeAccountAttributes(  # noqa: N802
        self, parameters: Parameters, moto: Moto
    ) -> Answer:
        platform = "VPC" if self._has_vpc else "EC2"
        body = (
            "<DescribeAccountAttributesResponse><accountAttributeSet><item>"
            "<attributeName>supported-platforms</attributeName><attributeValueSet><item>"
            f"<attributeValue>{platform}</attributeValue></item></attributeValueSet></item>"
            "</accountAttributeSet></DescribeAccountAttributesResponse>"
        )
        return "200 OK", XML, body.encode()


def _filters(parameters: Parameters) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for key, name in parameters.items():
        if match := re.fullmatch(r"Filter\.(\d+)\.Name", key):
            prefix = f"Filter.{match[1]}.Value."
            found[name] = [v for k, v in parameters.items() if k.startswith(prefix)]
    return found


def _passes(instance: Instance, name: str, patterns: list[str]) -> bool:
    if name.startswith("tag:"):
        values = [v for k, v in instance.tags.items() if k == name.removeprefix("tag:")]
    elif name == "tag-key":
        values = list(instance.tags)
    elif name == "client-token":
        values = [instance.token]
    elif name == "instance.group-name":
        values = instance.groups
    elif name == "instance-state-name":
        values = [instance.state]
    else:
        raise RefusedError("InvalidParameterValue", f"The filter '{name}' is invalid")
    return any(fnmatchcase(value, pattern) for value in values for pattern in patterns)
