"""The strict front: what moto lacks, added between the wire and moto.

::

    boto3 ──HTTP──> StrictCloud.__call__            (a thread for each request)
                      hook "before", injected errors
                      signature, rights, parameters that the cloud knows
                      rules.py: tokens, states, consistency, groups in use
                      moto, under a lock
                      hook "after", lost answers
"""

from __future__ import annotations

import io
import threading
import urllib.parse
import uuid
from collections.abc import Callable, Iterable
from socket import socket
from typing import Any, Self
from wsgiref.types import StartResponse, WSGIEnvironment

from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import WSGIRequestHandler, make_server

from cloud.calls import Call, CutError, Fault
from cloud.instances import Instance
from cloud.model import Model
from cloud.parameters import PROFILES, SILENT, unknown_parameters
from cloud.rules import RefusedError, Rules
from cloud.signature import SECRET_KEY, key_of, signed_region, verify


class StrictCloud:
    """An EC2 endpoint on loopback.

    Parameters
    ----------
    profile : str
        One of `PROFILES`.
    pending : int, optional
        How many descriptions an instance takes from pending to running, and from shutting-down
        to terminated; with None the test boots instances itself, and they end at once.
    lag, list_lag : int
        How many questions for a new instance's id, and how many lists, do not know it yet.
    vpc : bool, optional
        Whether the cloud has VPCs; by default all but the Eucalyptus of 4.
    listening : socket, optional
        Where it answers, the caller's; by default a port of its own on loopback.
    """

    def __init__(
        self,
        profile: str = "aws",
        *,
        pending: int | None = 1,
        lag: int = 1,
        list_lag: int = 0,
        vpc: bool | None = None,
        listening: socket | None = None,
    ) -> None:
        assert profile in PROFILES, profile
        self.profile = profile
        self.access_key = "AKIA" + uuid.uuid4().hex[:16].upper()
        self.secret_key = SECRET_KEY
        self.calls: list[Call] = []
        self.hook: Callable[[Call, str], None] | None = None
        self.on_launch: Callable[[Instance], None] | None = None
        self.on_terminate: Callable[[Instance], None] | None = None
        self.no_rights: set[str] = set()
        self._faults: list[Fault] = []
        self._lock = threading.RLock()
        self._moto = DomainDispatcherApplication(create_backend_app)
        self.model = Model(profile)
        has_vpc = not profile.startswith("euca-4") if vpc is None else vpc
        self._rules = Rules(self.model, profile, pending, lag, list_lag, has_vpc)
        address, port = listening.getsockname() if listening else ("127.0.0.1", 0)
        self._server = make_server(
            address,
            port,
            self,
            threaded=True,
            request_handler=_QuietHandler,
            fd=listening.fileno() if listening else None,
        )
        self._address = f"{address}:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End the endpoint, and forget all that was made."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
        self.model.close()

    # what a test says and asks ------------------------------------------------------------

    @property
    def image_id(self) -> str:
        """An image that exists."""
        return self.model.image_id

    @property
    def endpoint_url(self) -> str:
        """Of EC2, as the cloud lays it out."""
        path = "/services/compute/" if self.profile.startswith("euca") else "/"
        return f"http://{self._address}{path}"

    @property
    def s3_endpoint_url(self) -> str:
        """Of S3: moto's, as it is."""
        path = "/services/objectstorage/" if self.profile.startswith("euca") else "/"
        return f"http://{self._address}{path}"

    def environment(self) -> dict[str, str]:
        """Return what a process needs in its environment to be let in, and nothing else."""
        return {
            "AWS_ACCESS_KEY_ID": self.access_key,
            "AWS_SECRET_ACCESS_KEY": self.secret_key,
            "AWS_CONFIG_FILE": "/dev/null",
            "AWS_SHARED_CREDENTIALS_FILE": "/dev/null",
            "AWS_EC2_METADATA_DISABLED": "true",
        }

    def provider_block(self, **profiles: dict[str, object]) -> dict[str, object]:
        """Return the block ``provider`` of a cluster file; by default with one profile `small`."""
        kind = self.profile.partition("-")[0]
        image = {"id": self.image_id}
        default = {"image": image, "instance_type": "m5.large"}
        return {
            "type": {"aws": "aws", "euca": "eucalyptus", "generic": "ec2"}[kind],
            "capabilities": self.profile,
            "endpoint_url": self.endpoint_url,
            "s3_endpoint_url": self.s3_endpoint_url,
            "profiles": {name: default | values for name, values in profiles.items()}
            or {"small": default},
        }

    def fail(
        self,
        action: str,
        code: str,
        status: int = 400,
        *,
        message: str = "injected",
        match: dict[str, str] | None = None,
        times: int = 1,
    ) -> None:
        """Answer the next calls of an action (``*``: of any) with an error.

        `match` names parameters as on the wire, and their values.
        """
        self._faults.append(Fault(action, code, status, message, match or {}, times))

    def lose(self, action: str, *, times: int = 1) -> None:
        """Do what the next calls ask for, but lose the answers."""
        self._faults.append(Fault(action, "", 0, "", {}, times, loses_answer=True))

    @property
    def instances(self) -> list[Instance]:
        """All instances that ever were, in the order of their launch."""
        with self._lock:
            return list(self.model.instances.values())

    @property
    def living(self) -> list[Instance]:
        """Those that still cost something."""
        return [i for i in self.instances if i.state not in ("shutting-down", "terminated")]

    @property
    def groups(self) -> list[Any]:
        """moto's security groups, without those called default."""
        with self._lock:
            return self.model.groups()

    @property
    def key_pairs(self) -> list[str]:
        """The names of all key pairs."""
        with self._lock:
            return sorted(self.model.backend.key_pairs)

    def left(self) -> list[str]:
        """Name all that exists and would cost something, or stand in somebody's way."""
        groups = [group.name for group in self.groups]
        return [i.id for i in self.living] + groups + self.key_pairs

    # the wire -----------------------------------------------------------------------------

    def __call__(self, environ: WSGIEnvironment, start: StartResponse) -> Iterable[bytes]:
        body = environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        text = body.decode("latin-1")
        sent = dict(urllib.parse.parse_qsl(text, keep_blank_values=True))
        if "Action" not in sent:
            with self._lock:
                return self._ask_moto(environ, body, start)
        call = Call(sent.pop("Action"), {k: v for k, v in sent.items() if k != "Version"})
        with self._lock:
            self.calls.append(call)
            fault = next((fault for fault in self._faults if fault.fits(call)), None)
            if fault is not None:
                fault.times -= fault.times > 0
        try:
            self._tell("before", call)
            if fault is not None and not fault.loses_answer:
                raise RefusedError(fault.code, fault.message, fault.status)
            self._check(environ, body, call)
            status, headers, answer = self._act(environ, call, sent.get("Version", ""))
        except RefusedError as refused:
            status, headers, answer = refused.answer()
        self._tell("after", call)
        if fault is not None and fault.loses_answer:
            raise CutError("the answer is lost")
        start(status, headers)
        return [answer]

    def _tell(self, moment: str, call: Call) -> None:
        if self.hook is not None:
            self.hook(call, moment)

    def _check(self, environ: WSGIEnvironment, body: bytes, call: Call) -> None:
        path = urllib.parse.urlsplit(self.endpoint_url).path
        if environ["PATH_INFO"].rstrip("/") != path.rstrip("/"):
            raise RefusedError("InvalidAction", f"nothing answers at {environ['PATH_INFO']}", 404)
        if key_of(environ) != self.access_key:
            code = "AuthFailure" if self.profile == "aws" else "InvalidClientTokenId"
            raise RefusedError(code, "the access key is not known", 401)
        if not verify(environ, body):
            raise RefusedError("SignatureDoesNotMatch", "the secret key is another", 403)
        if call.action in self.no_rights:
            raise RefusedError(
                "UnauthorizedOperation", "You are not authorized to perform this operation.", 403
            )
        unknown = unknown_parameters(self.profile, call.action, list(call.parameters))
        if unknown is None:
            raise RefusedError("InvalidAction", f"The action {call.action} is not valid", 400)
        if unknown:
            fields = ", ".join(unknown)
            raise RefusedError("InvalidParameterValue", f"Failed to bind the fields: {fields}", 400)

    def _act(
        self, environ: WSGIEnvironment, call: Call, version: str
    ) -> tuple[str, list[tuple[str, str]], bytes]:
        def moto(parameters: dict[str, str]) -> tuple[str, list[tuple[str, str]], bytes]:
            body = urllib.parse.urlencode(
                {"Action": call.action, "Version": version, **parameters}
            ).encode()
            heads: list[tuple[str, list[tuple[str, str]]]] = []

            def start(
                status: str, headers: list[tuple[str, str]], *_: object
            ) -> Callable[..., None]:
                heads.append((status, headers))
                return lambda _: None

            answer = self._ask_moto({**environ, "PATH_INFO": "/"}, body, start)
            [(status, headers)] = heads
            # Its length goes, since rules change the body; the connection's end says it.
            headers = [(k, v) for k, v in headers if k.lower() != "content-length"]
            return status, headers, b"".join(answer)

        if self.profile != "aws" and call.action in SILENT:
            return "200 OK", [("Content-Type", "text/xml")], b"<Empty/>"
        with self._lock:
            before = set(self.model.instances)
            ending = {i.id for i in self.living}
            answer = self._rules.act(call.action, call.parameters, moto)
            launched = [i for i in self.instances if i.id not in before]
            ended = [i for i in self.instances if i.id in ending - {j.id for j in self.living}]
        for instance in launched:
            if self.on_launch is not None:
                self.on_launch(instance)
        for instance in ended:
            if self.on_terminate is not None:
                self.on_terminate(instance)
        return answer

    def _ask_moto(self, environ: WSGIEnvironment, body: bytes, start: StartResponse) -> list[bytes]:
        # moto knows the regions of Amazon only: whatever was signed for is served as us-east-1.
        environ = dict(environ)
        authorization = environ.get("HTTP_AUTHORIZATION", "")
        region = signed_region(authorization)
        if region:
            environ["HTTP_AUTHORIZATION"] = authorization.replace(f"/{region}/", "/us-east-1/", 1)
        environ["PATH_INFO"] = environ["PATH_INFO"].removeprefix("/services/objectstorage") or "/"
        environ["HTTP_X_MOTO_ACCOUNT_ID"] = self.model.account
        environ["wsgi.input"], environ["CONTENT_LENGTH"] = io.BytesIO(body), str(len(body))
        return list(self._moto(environ, start))


class _QuietHandler(WSGIRequestHandler):
    protocol_version = "HTTP/1.0"  # a connection for each request: a cut one is closed

    def log(self, type: str, message: str, *args: object) -> None:  # noqa: A002
        pass
