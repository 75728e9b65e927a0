"""The parameters of a launch, as each cloud may have them."""

from __future__ import annotations

import math

from hpccomponent.errors import CloudError
from hpcdeploy.provider import Launch
from hpcdeploy.providers.ec2.capabilities import Capabilities
from hpcdeploy.providers.ec2.client import Described, Parameters
from hpcdeploy.providers.ec2.names import (
    LEASE_TAG,
    MADE_TAG,
    OWNER_TAG,
    WORKERS_TAG,
    client_token,
    key_pair_name,
)
from hpcdeploy.providers.ec2.observe import identity_tags, lease_text
from hpcdeploy.spec.provider import CloudSpec, Profile

_PARTS = ("volume", "network-interface")
"""What comes and goes with a machine; the rules of an organisation may ask for tags on it too."""
USER_DATA_LIMIT = 16384
"""Bytes, on every cloud that we know."""


def attempt_of(launch: Launch) -> str:
    """Return what tells one launch of a node from the next that is tried."""
    return "-".join(filter(None, (launch.instance_type, launch.market, launch.place)))


def profile_of(cloud: CloudSpec, name: str) -> Profile:
    """Return a profile of the cluster file; raise CloudError where none has this name."""
    try:
        return cloud.profiles[name]
    except KeyError:
        known = ", ".join(sorted(cloud.profiles))
        raise CloudError(f"there is no profile {name!r}", f"the file has {known}") from None


def launch_tags(launch: Launch) -> dict[str, str]:
    """Return the tags of a machine: the user's own, and ours over them."""
    tags = launch.tags | identity_tags(launch.cluster, launch.incarnation, launch.name)
    if launch.lease_until is not None:
        tags[LEASE_TAG] = lease_text(launch.lease_until)
    if launch.made_as:
        tags[MADE_TAG] = launch.made_as
    if launch.desired is not None:
        tags[WORKERS_TAG] = str(launch.desired)
    return tags | ({OWNER_TAG: str(launch.owner)} if launch.owner.key else {})


def launch_parameters(
    cloud: CloudSpec,
    capabilities: Capabilities,
    launch: Launch,
    group_id: str,
    image: Described,
) -> Parameters:
    """Return what RunInstances is asked for; raise CloudError where the cloud cannot have it."""
    if launch.market == "spot" and not capabilities.spot:
        raise CloudError(
            f"{cloud.type} has no spot market", "set the profile's market to on_demand"
        )
    size = len(launch.user_data.encode())
    if size > USER_DATA_LIMIT:
        raise CloudError(
            f"user data of {launch.name.node} has {size} bytes, the limit is {USER_DATA_LIMIT}"
        )
    profile = profile_of(cloud, launch.profile)
    parameters: Parameters = {
        "ImageId": image["ImageId"],
        "InstanceType": launch.instance_type,
        "MinCount": 1,
        "MaxCount": 1,
        "KeyName": key_pair_name(launch.cluster, launch.incarnation),
        "SecurityGroupIds": [group_id],
        "ClientToken": client_token(
            launch.cluster, launch.incarnation, launch.name, attempt_of(launch)
        ),
    }
    if launch.user_data:
        parameters["UserData"] = launch.user_data
    subnet, zone = _place(cloud, profile, launch)
    if subnet:
        parameters["SubnetId"] = subnet
    if zone:
        parameters["Placement"] = {"AvailabilityZone": zone}
    if profile.iam_instance_profile is not None:
        kind = "Arn" if profile.iam_instance_profile.startswith("arn:") else "Name"
        parameters["IamInstanceProfile"] = {kind: profile.iam_instance_profile}
    disk = root_disk(image, profile.disk_gb)
    if disk is not None:
        parameters["BlockDeviceMappings"] = [disk]
    if profile.public_ip is not None:
        _set_public_ip(parameters, profile.public_ip, cloud, capabilities)
    return parameters | _where_known(capabilities, launch)


def _set_public_ip(
    parameters: Parameters, has_one: bool, cloud: CloudSpec, capabilities: Capabilities
) -> None:
    """Describe the interface of a machine, which then has the subnet and the group too."""
    if not capabilities.network_interfaces:
        raise CloudError(
            f"{cloud.type} ({cloud.capabilities}) cannot be told whether machines get a public "
            "address",
            "leave out the profile's public_ip, or set provider.capabilities",
        )
    interface = {
        "DeviceIndex": 0,
        "AssociatePublicIpAddress": has_one,
        "DeleteOnTermination": True,
        "Groups": parameters.pop("SecurityGroupIds"),
    }
    if "SubnetId" in parameters:
        interface["SubnetId"] = parameters.pop("SubnetId")
    parameters["NetworkInterfaces"] = [interface]


def _place(cloud: CloudSpec, profile: Profile, launch: Launch) -> tuple[str, str]:
    """Return subnet and zone of a launch; empty where the cloud may choose."""
    if launch.place in cloud.subnets:
        return launch.place, ""  # a subnet lies in one zone
    subnet, zone = ("".join(places[:1]) for places in (cloud.subnets, profile.zones))
    return subnet, launch.place or zone


def _where_known(capabilities: Capabilities, launch: Launch) -> Parameters:
    parameters: Parameters = {}
    if capabilities.tags_at_launch:
        tags = [{"Key": key, "Value": value} for key, value in launch_tags(launch).items()]
        kinds = ["instance", *(_PARTS if capabilities.tags_on_parts else ())]
        if capabilities.tags_on_parts and launch.market == "spot":
            kinds.append("spot-instances-request")
        parameters["TagSpecifications"] = [{"ResourceType": kind, "Tags": tags} for kind in kinds]
    if capabilities.ends_when_shut_down:
        parameters["InstanceInitiatedShutdownBehavior"] = "terminate"
    if capabilities.imds_v2:
        parameters["MetadataOptions"] = {"HttpTokens": "required", "HttpEndpoint": "enabled"}
    if launch.market == "spot":
        parameters["InstanceMarketOptions"] = {
            "MarketType": "spot",
            "SpotOptions": {
                "SpotInstanceType": "one-time",
                "InstanceInterruptionBehavior": "terminate",
            },
        }
    return parameters


def root_disk(image: Described, disk_gb: int | None) -> dict[str, object] | None:
    """Return how the root disk is to differ from the image's; None where it need not.

    A disk that outlives its machine would be left behind, so none does. `disk_gb` is in 10^9 bytes;
    by default the image's own. Raises CloudError where the image has no root volume.
    """
    root = image.get("RootDeviceName")
    volumes = {m.get("DeviceName"): m.get("Ebs", {}) for m in image.get("BlockDeviceMappings", [])}
    root_volume = volumes.get(root, {})
    if disk_gb is None and root_volume.get("DeleteOnTermination", True):
        return None
    if image.get("RootDeviceType") != "ebs" or not root:
        raise CloudError(
            f"image {image.get('ImageId', '')} has no root volume whose size could be set",
            "leave out the profile's disk_gb",
        )
    volume = {"DeleteOnTermination": True}
    size = root_volume.get("VolumeSize") if disk_gb is None else math.ceil(disk_gb * 10**9 / 2**30)
    return {"DeviceName": root, "Ebs": volume | ({"VolumeSize": size} if size else {})}
