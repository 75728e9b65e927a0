"""Signatures, verified: a client with wrong keys, or a request changed on the way, fails."""

from __future__ import annotations

import re
from wsgiref.types import WSGIEnvironment

from botocore.auth import SigV4Auth
from botocore.awsrequest import AWSRequest
from botocore.credentials import Credentials

SECRET_KEY = "wJalrXUtnFEMI/K7MDENG/bPxRfiCYEXAMPLEKEY"  # noqa: S105 - Amazon's own example
_SCOPE = re.compile(
    r"Credential=([^/]+)/\d+/([^/]+)/([^/]+)/aws4_request, ?SignedHeaders=([^,]+), ?Signature=(\w+)"
)


def key_of(environ: WSGIEnvironment) -> str:
    """Return the access key of a request; empty where it is not signed."""
    match = _SCOPE.search(environ.get("HTTP_AUTHORIZATION", ""))
    return match[1] if match else ""


def signed_region(authorization: str) -> str:
    """Return the region that a request was signed for."""
    match = _SCOPE.search(authorization)
    return match[2] if match else ""


def verify(environ: WSGIEnvironment, body: bytes) -> bool:
    """Tell whether a request was signed with our secret key."""
    match = _SCOPE.search(environ["HTTP_AUTHORIZATION"])
    assert match is not None
    key, region, service, names, signature = match.groups()
    headers = {}
    for name in names.split(";"):
        variable = name.upper().replace("-", "_")
        prefix = "" if name in ("content-type", "content-length") else "HTTP_"
        headers[name] = environ[prefix + variable]
    url = f"http://{environ['HTTP_HOST']}{environ['PATH_INFO']}"
    request = AWSRequest(environ["REQUEST_METHOD"], url, headers, body)
    request.context["timestamp"] = environ["HTTP_X_AMZ_DATE"]
    signer = SigV4Auth(Credentials(key, SECRET_KEY), service, region)
    text = signer.string_to_sign(request, signer.canonical_request(request))
    return bool(signer.signature(text, request) == signature)
