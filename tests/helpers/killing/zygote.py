"""Imports what `hpcapp up` needs once, then forks a process for each command that it reads.

Set-up is a stub whose steps are told to the test; times are short.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import socket
import sys
import tempfile
from typing import Any

import boto3
import paramiko
from botocore.loaders import JSONFileLoader

import hpcdeploy.install.bootstrap
import hpcdeploy.install.user_data
import hpcdeploy.providers.ec2.provider
import hpcdeploy.reconcile.converge
from hpcapp.cli import main
from hpcdeploy.spec.polling import Polling

STEPS = ("connect", "upload", "install", "start the loader")
KEY = paramiko.RSAKey.generate(2048)  # making one takes longer than a command


def remember_models() -> None:
    """Keep what botocore reads: the description of EC2 takes 0.3 s, for each client anew."""
    read = JSONFileLoader.load_file
    known: dict[str, object] = {}

    def load_file(self: object, path: str) -> object:
        if path not in known:
            known[path] = read(self, path)
        return known[path]

    JSONFileLoader.load_file = load_file
    for version in (None, "2014-09-01", "2016-11-15"):
        boto3.client("ec2", region_name="us-east-1", api_version=version).close()


def talk(channel: Any, line: str) -> None:
    """Tell the test, and wait until it answers: it may kill us instead."""
    channel.write(line + "\n")
    channel.flush()
    channel.readline()


def run(arguments: list[str], port: int, errors: Any) -> None:
    """Be ``hpcapp ARGUMENTS``; does not return."""
    os.dup2(errors.fileno(), 2)
    os.dup2(errors.fileno(), 1)
    connection = socket.create_connection(("127.0.0.1", port))
    channel = connection.makefile("rw")
    talk(channel, f"pid {os.getpid()}")

    def set_up(spec: Any, machines: Any, access: Any, report: Any) -> dict[str, str]:
        for machine in machines:
            for step in STEPS:
                talk(channel, f"step {machine.name.node}: {step}")
        talk(channel, "step head: write the inventory")
        return {}

    hpcdeploy.install.bootstrap.set_up = set_up
    try:
        main(arguments)
    except SystemExit as end:
        sys.stderr.flush()
        os._exit(int(end.code or 0))


def make_key(bits: int) -> paramiko.RSAKey:
    """Take the place of `paramiko.RSAKey.generate`."""
    return KEY


def serve(port: int) -> None:
    """Run every command that comes in, one after the other."""
    remember_models()
    paramiko.RSAKey.generate = make_key  # type: ignore[method-assign,assignment]
    hpcdeploy.install.user_data.user_data = lambda *about: "#!/bin/sh\n"
    short = functools.partial(Polling, poll_s=0.01, settle_s=0.05, end_s=20.0)
    hpcdeploy.reconcile.converge.Polling = short  # type: ignore[attr-defined,assignment]
    for line in sys.stdin:
        with tempfile.TemporaryFile() as errors:
            pid = os.fork()
            if pid == 0:
                with contextlib.suppress(BaseException):
                    arguments, environment = json.loads(line)
                    os.environ.update(environment)
                    run(arguments, port, errors)
                os._exit(99)
            code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            errors.seek(0)
            print(json.dumps([code, errors.read().decode()]), flush=True)  # noqa: T201


if __name__ == "__main__":
    serve(int(sys.argv[1]))
