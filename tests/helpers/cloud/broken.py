"""Ways in which the way to a cloud is broken: servers on loopback, and AWS's own files.

::

    with BrokenWays(folder) as ways:
        for fault in ways.faults():
            fault.environment     what a process needs; nothing outside loopback is asked
            fault.endpoint_url    of EC2
            fault.says            what a user must be told
"""

from __future__ import annotations

import contextlib
import datetime
import ipaddress
import json
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from hashlib import sha1
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Self

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

START_URL = "https://lab.awsapps.example/start"
KEYS = "aws_access_key_id = AKIA0000000000000000\naws_secret_access_key = secret\n"
SSO = "sso_account_id = 123456789012\nsso_role_name = Lab\n"
REFUSAL = """<ErrorResponse><Error><Code>AccessDenied</Code>
<Message>User: arn:aws:iam::1:user/me is not authorized to perform: sts:AssumeRole</Message>
</Error></ErrorResponse>"""


@dataclass(frozen=True, slots=True)
class Fault:
    """One way in which it is broken.

    Parameters
    ----------
    says : tuple of str
        What the one line must hold.
    config : str
        Of ``~/.aws/config``.
    environment : dict
        Besides what all have.
    endpoint_url : str
        Of EC2.
    profile : str
        ``provider.credentials.profile``; empty for none.
    """

    name: str
    says: tuple[str, ...]
    config: str = ""
    environment: dict[str, str] = field(default_factory=dict)
    endpoint_url: str = "http://127.0.0.1:9/"
    profile: str = "lab"


class BrokenWays:
    """Servers on loopback that do not do what they are there for.

    Parameters
    ----------
    folder : Path
        Gets AWS's files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._closer = ExitStack()
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.closed = f"127.0.0.1:{probe.getsockname()[1]}"
        self.silent = self._closer.enter_context(_silent_server())
        self.black_hole = self._closer.enter_context(_black_hole())
        self.refusing = self._closer.enter_context(answering(403, REFUSAL))
        self.page = self._closer.enter_context(answering(403, "<html><p>Not for you</html>"))
        self.self_signed, _ = self._closer.enter_context(self_signed_server(folder))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._closer.close()

    def environment(self, fault: Fault) -> dict[str, str]:
        """Write AWS's files for a fault; return the variables that name them."""
        home = self.folder / fault.name.replace(" ", "-")
        (home / ".aws").mkdir(parents=True, exist_ok=True)
        (home / ".aws/config").write_text(fault.config)
        (home / ".aws/credentials").write_text("")
        expired = {
            "startUrl": START_URL,
            "region": "us-east-1",
            "accessToken": "old",
            "expiresAt": "2020-01-01T00:00:00Z",
        }
        if "expired" in fault.name:
            cache = home / ".aws/sso/cache"
            cache.mkdir(parents=True, exist_ok=True)
            for key in (START_URL, "corp"):
                named = cache / f"{sha1(key.encode()).hexdigest()}.json"  # noqa: S324 - AWS's way
                named.write_text(json.dumps(expired))
        return {
            "HOME": str(home),
            "AWS_CONFIG_FILE": str(home / ".aws/config"),
            "AWS_SHARED_CREDENTIALS_FILE": str(home / ".aws/credentials"),
            "AWS_EC2_METADATA_SERVICE_ENDPOINT": f"http://{self.black_hole}/",
            "AWS_ENDPOINT_URL_STS": f"http://{self.closed}",
            "AWS_ENDPOINT_URL_SSO": f"http://{self.closed}",
            "AWS_ENDPOINT_URL_SSO_OIDC": f"http://{self.closed}",
            "XDG_STATE_HOME": str(home / "state"),
            **fault.environment,
        }

    def faults(self) -> list[Fault]:
        """Return all of them."""
        return [*self._of_roles(), *self._of_sso(), *self._of_sources(), *self._of_endpoints()]

    def _of_roles(self) -> list[Fault]:
        role = (
            "[profile lab]\nrole_arn = arn:aws:iam::123456789012:role/lab\n"
            f"source_profile = keys\n\n[profile keys]\n{KEYS}"
        )
        sts = "AWS_ENDPOINT_URL_STS"
        reached = ("profile lab", "AWS_ENDPOINT_URL_STS", "HTTPS_PROXY")
        return [
            Fault("role refused port", reached, role),
            Fault("role black hole", reached, role, {sts: f"http://{self.black_hole}"}),
            Fault("role silent", reached, role, {sts: f"http://{self.silent}"}),
            Fault(
                "role not allowed",
                ("profile lab", "sts:AssumeRole", "role/lab"),
                role,
                {sts: f"http://{self.refusing}"},
            ),
            Fault(
                "role without source",
                ("profile lab", "source_profile", "mend", "config"),
                role.partition("\n[profile keys]")[0],
            ),
            Fault(
                "role with MFA",
                ("profile lab", "MFA", "aws sts get-caller-identity --profile lab"),
                role.replace(
                    "source_profile", "mfa_serial = arn:aws:iam::1:mfa/me\nsource_profile"
                ),
            ),
        ]

    def _of_sso(self) -> list[Fault]:
        session = f"[sso-session corp]\nsso_start_url = {START_URL}\nsso_region = us-east-1\n"
        by_session = f"[profile lab]\nsso_session = corp\n{SSO}\n{session}"
        legacy = f"[profile lab]\nsso_start_url = {START_URL}\nsso_region = us-east-1\n{SSO}"
        says = ("profile lab", "SSO", "aws sso login --profile lab")
        return [
            Fault("SSO never", says, by_session),
            Fault("SSO expired", says, by_session),
            Fault("legacy SSO never", says, legacy),
            Fault("legacy SSO expired", says, legacy),
        ]

    def _of_sources(self) -> list[Fault]:
        process = "[profile lab]\ncredential_process = "
        web = "[profile lab]\nrole_arn = arn:aws:iam::1:role/lab\nweb_identity_token_file = "
        from_machine = (
            "[profile lab]\nrole_arn = arn:aws:iam::1:role/lab\n"
            "credential_source = Ec2InstanceMetadata\n"
        )
        by_hand = ("profile lab", "credential_process", "by hand")
        return [
            Fault("process fails", ("not logged in", *by_hand),
                  process + "sh -c 'echo not logged in >&2; exit 3'\n"),
            Fault("process hangs", ("did not end within", *by_hand), process + "sleep 100\n"),
            Fault("process prints junk", by_hand, process + "echo hello\n"),
            Fault("process missing", ("no-such-program", *by_hand), process + "no-such-program\n"),
            Fault("web identity missing", ("/nonexistent/token", "profile lab", "token"),
                  web + "/nonexistent/token\n"),
            Fault("machine's role", ("profile lab", "Ec2InstanceMetadata"), from_machine),
            Fault("no keys anywhere", ("no keys", "aws configure"), profile=""),
            Fault("unknown profile", ("no profile lab", "list-profiles"), "[profile other]\n"),
            Fault("unreadable config", ("config", "mend"), "[profile lab\n"),
        ]  # fmt: skip

    def _of_endpoints(self) -> list[Fault]:
        keys = f"[profile lab]\n{KEYS}"
        proxied = "http://ec2.lab.example/"

        def by_proxy(address: str) -> dict[str, str]:
            names = ("HTTP_PROXY", "http_proxy", "HTTPS_PROXY", "https_proxy")
            return dict.fromkeys(names, f"http://me:hush@{address}")

        endpoint = "provider.endpoint_url"
        return [
            Fault("proxy closed", ("proxy", "NO_PROXY"), keys, by_proxy(self.closed), proxied),
            Fault("proxy refuses", ("something other than EC2", "proxy"), keys,
                  by_proxy(self.page), proxied),
            Fault("proxy refuses TLS", ("proxy", "NO_PROXY"), keys, by_proxy(self.page),
                  proxied.replace("http:", "https:")),
            Fault("unresolved", (endpoint, "nosuch.invalid"), keys, {}, "http://nosuch.invalid/"),
            Fault("endpoint closed", (endpoint,), keys, {}, f"http://{self.closed}/"),
            Fault("endpoint silent", (endpoint,), keys, {}, f"http://{self.silent}/"),
            Fault("endpoint black hole", (endpoint,), keys, {}, f"http://{self.black_hole}/"),
            Fault("endpoint self-signed", ("provider.ca_bundle",), keys, {}, self.self_signed),
            Fault("certificates missing", ("/nonexistent/ca.pem", "AWS_CA_BUNDLE"), keys,
                  {"AWS_CA_BUNDLE": "/nonexistent/ca.pem"}, self.self_signed),
        ]  # fmt: skip


@contextlib.contextmanager
def _silent_server() -> Iterator[str]:
    """Accept connections, and never answer."""
    with socket.create_server(("127.0.0.1", 0), backlog=64) as server:
        yield "{}:{}".format(*server.getsockname())


@contextlib.contextmanager
def _black_hole() -> Iterator[str]:
    """Let nobody connect, and refuse nobody: the queue of connections is full."""
    with ExitStack() as closer:
        server = closer.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        for _ in range(4):
            filler = closer.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(server.getsockname())
        yield "{}:{}".format(*server.getsockname())


@contextlib.contextmanager
def _served(server: ThreadingHTTPServer) -> Iterator[None]:
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
        with contextlib.suppress(OSError):
            server.server_close()


@contextlib.contextmanager
def answering(status: int, page: str | Callable[[], str]) -> Iterator[str]:
    """Answer everything with one page."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.do_POST()

        def do_POST(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length") or 0))
            text = page if isinstance(page, str) else page()
            self.send_response(status)
            self.send_header("Content-Type", "text/xml")
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text.encode())

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Page)
    server.daemon_threads = True
    with _served(server):
        yield f"127.0.0.1:{server.server_port}"


class _QuietServer(ThreadingHTTPServer):
    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing where a client turns away from our certificate."""


@contextlib.contextmanager
def self_signed_server(
    folder: Path, page: type[BaseHTTPRequestHandler] = BaseHTTPRequestHandler
) -> Iterator[tuple[str, Path]]:
    """Serve behind a certificate that nobody knows; give the address and the certificate's file."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "127.0.0.1")])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), False
        )
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    (folder / "cloud-cert.pem").write_bytes(certificate.public_bytes(pem))
    (folder / "key.pem").write_bytes(
        key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "cloud-cert.pem", folder / "key.pem")
    server = _QuietServer(("127.0.0.1", 0), page)
    server.daemon_threads = True
    # Shaken hands when first read: a client that turns away is no error of the server's.
    server.socket = context.wrap_socket(
        server.socket, server_side=True, do_handshake_on_connect=False
    )
    with _served(server):
        yield f"https://127.0.0.1:{server.server_port}/", folder / "cloud-cert.pem"
