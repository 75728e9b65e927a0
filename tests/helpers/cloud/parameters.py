"""Which calls and parameters a cloud knows: a Eucalyptus fails a call with any other parameter.

Parameters are written as on the wire, with N for every number.
"""

from __future__ import annotations

import re

EUCALYPTUS_VERSIONS = ("4.0", "4.1", "4.2", "4.3", "4.4", "5.0", "5.1")
PROFILES = ("aws", *(f"euca-{version}" for version in EUCALYPTUS_VERSIONS), "generic")

# Stubs of a Eucalyptus: an empty reply, and no error.
SILENT = {"DescribeInstanceTypes", "DescribeSpotInstanceRequests", "RequestSpotInstances"}

_FILTER = "Filter.N.Name Filter.N.Value.N"
_RULES = (
    "GroupId GroupName IpPermissions.N.IpProtocol IpPermissions.N.FromPort IpPermissions.N.ToPort"
    " IpPermissions.N.IpRanges.N.CidrIp IpPermissions.N.Groups.N.UserId"
    " IpPermissions.N.Groups.N.GroupId IpPermissions.N.Groups.N.GroupName"
)
_SINCE_4_0 = {
    "AuthorizeSecurityGroupIngress": _RULES,
    "CreateSecurityGroup": "GroupName GroupDescription",
    "CreateTags": "ResourceId.N Tag.N.Key Tag.N.Value",
    "DeleteKeyPair": "KeyName",
    "DeleteSecurityGroup": "GroupId GroupName",
    "DescribeAccountAttributes": "AttributeName.N",
    "DescribeAvailabilityZones": f"ZoneName.N {_FILTER}",
    "DescribeImages": f"ImageId.N Owner.N ExecutableBy.N {_FILTER}",
    "DescribeInstances": f"InstanceId.N {_FILTER}",
    "DescribeInstanceTypes": "",
    "DescribeKeyPairs": f"KeyName.N {_FILTER}",
    "DescribeRegions": "",
    "DescribeSecurityGroups": f"GroupId.N GroupName.N {_FILTER}",
    "DescribeSpotInstanceRequests": "",
    "GetConsoleOutput": "InstanceId",
    "ImportKeyPair": "KeyName PublicKeyMaterial",
    "RequestSpotInstances": "",
    "RevokeSecurityGroupIngress": _RULES,
    "RunInstances": (
        "ImageId MinCount MaxCount InstanceType KeyName SecurityGroup.N SecurityGroupId.N UserData"
        " ClientToken Placement.AvailabilityZone BlockDeviceMapping.N.DeviceName"
        " BlockDeviceMapping.N.Ebs.VolumeSize BlockDeviceMapping.N.Ebs.DeleteOnTermination"
        " InstanceInitiatedShutdownBehavior IamInstanceProfile.Name"
    ),
    "TerminateInstances": "InstanceId.N",
}
_SINCE_4_1 = {
    "CreateSecurityGroup": "VpcId",
    "DescribeSubnets": f"SubnetId.N {_FILTER}",
    "DescribeVpcs": f"VpcId.N {_FILTER}",
    "RunInstances": (
        "SubnetId NetworkInterface.N.DeviceIndex NetworkInterface.N.AssociatePublicIpAddress"
        " NetworkInterface.N.DeleteOnTermination NetworkInterface.N.SubnetId"
        " NetworkInterface.N.SecurityGroupId.N"
    ),
}
_SINCE_5_0 = {
    "RunInstances": (
        "TagSpecification.N.ResourceType TagSpecification.N.Tag.N.Key"
        " TagSpecification.N.Tag.N.Value"
    )
}


def unknown_parameters(profile: str, action: str, names: list[str]) -> list[str] | None:
    """Return the parameters that a cloud does not know; None where it does not know the call.

    Amazon's own are checked by boto3, whose model is Amazon's.
    """
    if profile == "aws":
        return []
    version = profile.removeprefix("euca-")
    tables = [_SINCE_4_0]
    if profile == "generic" or version >= "4.1":
        tables.append(_SINCE_4_1)
    if profile != "generic" and version >= "5.0":
        tables.append(_SINCE_5_0)
    if not any(action in table for table in tables):
        return None
    known = {word for table in tables for word in table.get(action, "").split()}
    return [name for name in names if re.sub(r"(?<=\.)\d+", "N", name) not in known]
