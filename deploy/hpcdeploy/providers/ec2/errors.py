"""Errors of boto3 and of the clouds, translated in this one place."""

from __future__ import annotations

import botocore.exceptions as boto
from botocore.parsers import ResponseParserError

from hpccomponent.errors import CapacityError, CloudError

BOTO_ERRORS = (boto.ClientError, boto.BotoCoreError, ResponseParserError)
"""All that a call may raise: the last, of no family, where a web page answers instead of EC2."""

_CAPACITY = {
    "InsufficientCapacity",
    "InsufficientFreeAddressesInSubnet",
    "InsufficientHostCapacity",
    "InsufficientInstanceCapacity",
    "InsufficientReservedInstanceCapacity",
    "InstanceLimitExceeded",
    "MaxSpotInstanceCountExceeded",
    "SpotMaxPriceTooLow",
    "Unsupported",
    "VcpuLimitExceeded",
}
_THROTTLED = {
    "BandwidthLimitExceeded",
    "EC2ThrottledException",
    "RequestLimitExceeded",
    "RequestThrottled",
    "SlowDown",
    "Throttling",
    "ThrottlingException",
    "TooManyRequestsException",
}
NETWORK_ERRORS = (
    boto.ConnectionError,  # among them a proxy's, and certificates
    boto.HTTPClientError,
    boto.ReadTimeoutError,
)
"""No answer, or none that may be trusted."""
_LOST = (*NETWORK_ERRORS, ResponseParserError)  # a gateway's page may hide that it was done
_EXPIRED = {
    "AuthFailure.Expired",
    "ExpiredToken",
    "ExpiredTokenException",
    "RequestExpired",
}
_KEYS = "check provider.credentials, or the environment's AWS_ACCESS_KEY_ID"
_CLOCK = "check this machine's clock (timedatectl)"
_RENEW = "get new credentials (for AWS: aws sso login, or new session keys)"
_TYPE = "name other instance types, another zone, or wait"
_QUOTA = "ask for a higher quota, take fewer workers, or another instance type"
_ADVICE = {
    "AddressLimitExceeded": _QUOTA,
    "AuthFailure": f"{_KEYS}, and {_CLOCK}",
    "AuthFailure.ServiceLinkedRoleCreationNotPermitted": (
        "let the keys iam:CreateServiceLinkedRole for spot.amazonaws.com once"
    ),
    "Blocked": "ask the cloud's support: the account may not do this",
    "ExpiredToken": _RENEW,
    "ExpiredTokenException": _RENEW,
    "IncompleteSignature": _KEYS,
    "InstanceLimitExceeded": _QUOTA,
    "InsufficientFreeAddressesInSubnet": "name a larger provider.subnet, or end other machines",
    "InvalidAMIID.Malformed": "check the profile's image.id",
    "InvalidAMIID.NotFound": "check the profile's image.id; images differ from region to region",
    "InvalidAMIID.Unavailable": "check the profile's image.id; images differ from region to region",
    "InvalidAction": "check provider.endpoint_url and provider.capabilities",
    "InvalidBlockDeviceMapping": "raise the profile's disk_gb to the image's own size at least",
    "InvalidClientTokenId": _KEYS,
    "InvalidInstanceType": "check the profile's instance_type; types differ by region and zone",
    "InvalidKey.Format": "a key pair takes RSA keys of 2048 or 4096 bits: see auth.ssh_private_key",
    "InvalidSubnet": "check provider.subnet",
    "InvalidSubnetID.NotFound": "check provider.subnet",
    "MaxSpotInstanceCountExceeded": "use market: spot_with_fallback, or ask for a higher quota",
    "OptInRequired": "subscribe to the image or the region in the cloud's console",
    "PendingVerification": "wait until the cloud has verified the account",
    "RequestExpired": _CLOCK,
    "SecurityGroupLimitExceeded": _QUOTA,
    "SignatureDoesNotMatch": "the secret key is not the access key's: check provider.credentials",
    "UnrecognizedClientException": _KEYS,
    "UnsupportedOperation": "check provider.capabilities",
    "Unsupported": _TYPE,
    "VPCIdNotSpecified": "name a provider.subnet: the account has no default VPC",
    "VcpuLimitExceeded": _QUOTA,
}


def code_of(error: BaseException | None) -> str:
    """Return the code that a cloud gave its error, translated or not; empty for any other."""
    if isinstance(error, CloudError):
        return code_of(error.__cause__)
    if isinstance(error, boto.ClientError):
        return str(error.response.get("Error", {}).get("Code", ""))
    return ""


def is_throttled(error: Exception) -> bool:
    """Tell whether a cloud asks for patience."""
    return code_of(error) in _THROTTLED


def has_expired(error: Exception) -> bool:
    """Tell whether the keys were good once, so that newer ones may lie where they came from."""
    return code_of(error) in _EXPIRED or isinstance(
        error.__cause__, boto.RefreshWithMFAUnsupportedError
    )


def is_lost_answer(error: Exception) -> bool:
    """Tell whether a request may have been done though no answer came."""
    if isinstance(error, boto.ClientError):
        status = error.response.get("ResponseMetadata", {}).get("HTTPStatusCode", 0)
        return status >= 500 and code_of(error) not in _CAPACITY
    return isinstance(error, _LOST) and not isinstance(error, boto.SSLError)


def translate(error: Exception, doing: str, place: str) -> CloudError:
    """Return an error of boto3 as the one line that a user reads.

    `doing` is what was asked for: "launch worker-2 (m5.large, spot)". A `CapacityError` is returned
    where another type, market or zone may still be had.
    """
    if isinstance(error, ResponseParserError):
        return CloudError(f"{place}: cannot {doing}: the answer is no EC2 answer", _advise(error))
    if not isinstance(error, boto.ClientError):
        return CloudError(f"{place}: cannot {doing}: {_one_line(str(error))}", _advise(error))
    code = code_of(error)
    message = _one_line(str(error.response.get("Error", {}).get("Message", "")))
    problem = f"{place}: cannot {doing}: {message.rstrip('.')} ({code})"
    if code in {"UnauthorizedOperation", "AccessDenied", "AccessDeniedException"}:
        return CloudError(problem, f"the credentials lack the right ec2:{error.operation_name}")
    if code in _CAPACITY or code.startswith("Insufficient"):
        return CapacityError(problem, _ADVICE.get(code, _TYPE))
    if is_throttled(error):
        return CloudError(problem, "the cloud asks for fewer calls: try again in a minute")
    return CloudError(problem, _ADVICE.get(code, ""))


def _advise(error: Exception) -> str:
    if isinstance(error, boto.SSLError):
        return "name the cloud's certificate in provider.ca_bundle, and check that it is https"
    if isinstance(error, boto.ProxyConnectionError):
        return "check the proxy (HTTPS_PROXY, HTTP_PROXY), or name the cloud's host in NO_PROXY"
    if isinstance(error, boto.NoCredentialsError | boto.PartialCredentialsError):
        return "name provider.credentials, or set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
    if isinstance(error, boto.InvalidRegionError):
        return 'name a provider.signing_region, such as "eucalyptus"'
    if isinstance(error, boto.ParamValidationError | boto.UnknownServiceError):
        return "check provider.capabilities"
    if isinstance(error, ResponseParserError):
        return (
            "something other than EC2 answers: check provider.endpoint_url and the proxy "
            "(HTTPS_PROXY, HTTP_PROXY, NO_PROXY)"
        )
    if isinstance(error, _LOST):
        return "check provider.endpoint_url, provider.region and the network, and try again"
    return ""


def _one_line(text: str) -> str:
    # Amazon appends a cipher of a thousand characters to what it does not permit.
    return " ".join(text.partition("Encoded authorization failure message")[0].split())[:400]
