"""What would make `up` fail, found without changing anything."""

from __future__ import annotations

from dataclasses import replace

from hpccomponent.errors import CloudError
from hpcdeploy.provider import Problem
from hpcdeploy.providers.ec2.capabilities import Capabilities
from hpcdeploy.providers.ec2.client import Calls, Parameters
from hpcdeploy.providers.ec2.errors import code_of
from hpcdeploy.providers.ec2.images import Images
from hpcdeploy.providers.ec2.launch import root_disk
from hpcdeploy.spec.provider import CloudSpec, Profile


def check_cloud(
    calls: Calls, cloud: CloudSpec, capabilities: Capabilities, images: Images
) -> list[Problem]:
    """Look at credentials, images, types, zones, subnet and rights, as far as `capabilities` go.

    A cloud that cannot be reached, or does not let us in, is the only problem named: all others
    follow from it.
    """
    try:
        zones = calls.call("describe_availability_zones", "list the zones")["AvailabilityZones"]
    except CloudError as error:
        return [_problem(error)]
    problems = []
    known = {zone["ZoneName"] for zone in zones}
    problems += _check_subnets(calls, cloud)
    for name, profile in cloud.profiles.items():
        problems += [
            Problem(
                f"profile {name}: there is no zone {zone}",
                f"the cloud has {', '.join(sorted(known)) or 'none'}",
            )
            for zone in profile.zones
            if zone not in known
        ]
        problems += _check_image(images, name, profile)
        if capabilities.instance_types:
            problems += _check_types(calls, name, profile)
        if capabilities.dry_run:
            problems += _dry_run(calls, cloud, profile, images)
    return problems


def _check_subnets(calls: Calls, cloud: CloudSpec) -> list[Problem]:
    """Find the subnets; the security group is made in one VPC, so all must lie in it."""
    problems: list[Problem] = []
    vpcs: dict[str, str] = {}
    for subnet in cloud.subnets:
        try:
            reply = calls.call("describe_subnets", f"find subnet {subnet}", SubnetIds=[subnet])
        except CloudError as error:
            problems.append(_problem(error))
            continue
        vpcs.update((subnet, described.get("VpcId") or "no VPC") for described in reply["Subnets"])
    if len(set(vpcs.values())) > 1:
        lie = ", ".join(f"{subnet} in {vpc}" for subnet, vpc in vpcs.items())
        problems.append(
            Problem(f"provider.subnet: {lie}", "name subnets of one VPC: the machines meet there")
        )
    return problems


def _problem(error: CloudError) -> Problem:
    """Return what a question has met; one that we may not ask stops nothing by itself."""
    return Problem(error.problem, error.advice, is_fatal=code_of(error) != "UnauthorizedOperation")


def _tried(calls: Calls, operation: str, doing: str, parameters: Parameters) -> list[Problem]:
    try:
        calls.call(operation, doing, **parameters)
    except CloudError as error:
        return [_problem(error)]
    return []


def _check_types(calls: Calls, name: str, profile: Profile) -> list[Problem]:
    """Find the types that there are; a profile needs one of its own."""
    problems = [
        problem
        for kind in profile.instance_types
        for problem in _tried(
            calls,
            "describe_instance_types",
            f"find instance type {kind} of profile {name}",
            {"InstanceTypes": [kind]},
        )
    ]
    has_one = len(problems) < len(profile.instance_types)
    return [replace(problem, is_fatal=problem.is_fatal and not has_one) for problem in problems]


def _check_image(images: Images, name: str, profile: Profile) -> list[Problem]:
    try:
        root_disk(images.find(profile.image), profile.disk_gb)
    except CloudError as error:
        return [Problem(f"profile {name}: {error.problem}", error.advice)]
    return []


def _dry_run(calls: Calls, cloud: CloudSpec, profile: Profile, images: Images) -> list[Problem]:
    """Ask whether a launch would be let through; the answer is an error either way."""
    try:
        image = images.find(profile.image)
    except CloudError:
        return []  # it is told already
    parameters: Parameters = {
        "ImageId": image["ImageId"],
        "InstanceType": profile.instance_types[0],
        "MinCount": 1,
        "MaxCount": 1,
        "DryRun": True,
    }
    if cloud.subnets:
        parameters["SubnetId"] = cloud.subnets[0]
    try:
        calls.call("run_instances", "launch a machine (dry run)", **parameters)
    except CloudError as error:
        if code_of(error) == "UnauthorizedOperation":
            return [Problem(error.problem, error.advice)]
    return []
