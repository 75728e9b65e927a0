"""The messages between master and component, and their strict decoding.

::

    component                                   master
      │ Register (versions, build, capabilities)  │
      │ ────────────────────────────────────────> │
      │        Registered (session) or Refused    │
      │ <──────────────────────────────────────── │
      │        Share (a blob), then Batch (calls) │
      │ <──────────────────────────────────────── │
      │ Results or Announce, Lost, Need, Heartbeat│
      │ ────────────────────────────────────────> │
      │        Fetch, Release (what was announced)│
      │ <──────────────────────────────────────── │
      │ Piece                                     │
      │ ────────────────────────────────────────> │
      │        Ping, RegisterAgain, Forget, Drain │
      │ <──────────────────────────────────────── │
      │ Goodbye                         Farewell  │

The first frame of a wire message is one of these in MessagePack; the frames after it are the
buffers that it, its calls or its results announce. A component sends little unasked: results that
are large stay with it as a parcel, which the master fetches piece by piece. Every message after
the handshake names the session, which lives as long as one master.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.blobs import KEY_BYTES
from hpccomponent.protocol.frames import DEFAULT_RESULT_BYTES

PROTOCOL_VERSION = 5

MAX_TRACEBACK = 20_000  # characters

Count = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]
Line = Annotated[str, msgspec.Meta(max_length=4000)]
Key = Annotated[bytes, msgspec.Meta(min_length=KEY_BYTES, max_length=KEY_BYTES)]


class Register(msgspec.Struct, frozen=True, tag=True):
    """The first message of a component.

    Unknown fields are let pass here, and here only, so that a newer component gets a refusal
    that names the versions, and not silence. `blob_bytes` is how much of the blobs that no batch
    of it needs the component keeps, in bytes.
    """

    protocol: int
    package: Line
    worker: Name
    incarnation: Name
    build: Line
    numerics: Line
    cores: Count
    memory_bytes: Count
    largest_frame: Count
    blob_bytes: Count = 0


class Registered(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The master's yes: from now on the session, and what both keep to.

    `heartbeat_s` is how often the component reports, `silence_s` how long it waits for a silent
    master (both in seconds), `largest_frame` what neither sends more than (in bytes).
    """

    session: Name
    heartbeat_s: Seconds
    silence_s: Seconds
    largest_frame: Annotated[int, msgspec.Meta(ge=1024, lt=2**31)]


class Refused(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The master's no, with its reason; the component leaves."""

    reason: Line


class RegisterAgain(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The answer to a message of a component that the master does not know."""


class Ping(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The master lives; sending it also probes the way to the component.

    `last_batch` and `last_fetch` are the numbers of the last batch and the last request for a
    piece that were sent, to any component.
    """

    session: Name
    last_batch: Count
    last_fetch: Count = 0


class Drain(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """Finish what you have, then say goodbye."""

    session: Name


class Farewell(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The job is over; leave."""

    session: Name


class Share(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """A blob, for the batches after it: its key, its encoded value, the length of its buffers."""

    session: Name
    key: Key
    header: bytes
    sizes: list[Count]


class Forget(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """Blobs that nobody will name again."""

    session: Name
    keys: list[Key]


class Call(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One task: its number, name, encoded arguments, length of its buffers, blobs it names.

    `limit_bytes` is how large its encoded result may be, header and buffers together.
    """

    task: Count
    name: Name
    header: bytes
    sizes: list[Count]
    blobs: list[Key] = []
    limit_bytes: Count = DEFAULT_RESULT_BYTES


class Batch(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """Tasks for one worker, to be run in their order."""

    session: Name
    batch: Count
    calls: Annotated[list[Call], msgspec.Meta(min_length=1)]


class Failure(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What a task raised: the class's name, one line, what to do, and the remote traceback."""

    kind: Name
    problem: Line
    advice: Line
    traceback: Annotated[str, msgspec.Meta(max_length=MAX_TRACEBACK)]


class Result(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What became of one task, and how many seconds its function took.

    `written` is the checksum of what it has written to files and stores.
    """

    task: Count
    seconds: Seconds
    header: bytes
    sizes: list[Count]
    failure: Failure | None = None
    written: Count = 0


class Results(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """Results of a batch, as they become ready; `is_finished` with the last of them.

    `number` counts what a component says of results, parcels with them, from 1; a worker process
    leaves that to its component.
    """

    session: Name
    batch: Count
    results: list[Result]
    is_finished: bool
    number: Count = 0


class Announce(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """Results of a batch that stay with the component until they are fetched: a parcel.

    Its content is the first frame of a `Results` message for these tasks, of `head_bytes`, and
    then its buffers, laid out for `cut_payload`. `number` counts as in `Results`.
    """

    session: Name
    batch: Count
    number: Count
    tasks: list[Count]
    head_bytes: Count
    payload_bytes: Count


class Fetch(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """A request for the bytes of a parcel from `start` to `end`, under a number of its own."""

    session: Name
    fetch: Count
    parcel: Count
    start: Count
    end: Count


class Piece(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The answer to a `Fetch`: its bytes are the frames after this one."""

    session: Name
    fetch: Count


class Release(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """Results up to this number have been taken, or are wanted no more, parcels with them."""

    session: Name
    number: Count


class Lost(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The worker process died; `is_blamed` on the batch that it was running."""

    session: Name
    batch: Count
    reason: Line
    is_blamed: bool


class Need(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """A batch was put back because these of its blobs are not (or no longer) here."""

    session: Name
    batch: Count
    keys: Annotated[list[Key], msgspec.Meta(min_length=1)]


class Heartbeat(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The component lives, and has received every batch up to `last_batch` that was not lost.

    `progress` counts the tasks that its worker has finished, `held` names the batches that it
    has not finished. `last_batch` and `last_fetch` are those of the last ping: what was asked for
    up to there has been answered. `last_results` is the number of the last results that were sent
    or announced, `released` up to where they have been released.
    """

    session: Name
    progress: Count
    last_batch: Count
    held: list[Count]
    last_fetch: Count = 0
    last_results: Count = 0
    released: Count = 0


class Goodbye(msgspec.Struct, frozen=True, tag=True, forbid_unknown_fields=True):
    """The component leaves of its own accord; what it has not finished goes elsewhere."""

    session: Name
    reason: Line


MasterMessage = (
    Registered
    | Refused
    | RegisterAgain
    | Ping
    | Drain
    | Farewell
    | Share
    | Forget
    | Batch
    | Fetch
    | Release
)
ComponentMessage = Register | Results | Announce | Piece | Lost | Need | Heartbeat | Goodbye

_encoder = msgspec.msgpack.Encoder()
_master_decoder: msgspec.msgpack.Decoder[MasterMessage] = msgspec.msgpack.Decoder(MasterMessage)
_component_decoder: msgspec.msgpack.Decoder[ComponentMessage] = msgspec.msgpack.Decoder(
    ComponentMessage
)


def encode_message(message: MasterMessage | ComponentMessage) -> bytes:
    """Encode a message as the first frame of a wire message."""
    return _encoder.encode(message)


def decode_master_message(frame: bytes | memoryview) -> MasterMessage:
    """Decode what a master sent; ProtocolError where the frame is not exactly such a message."""
    try:
        return _master_decoder.decode(frame)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ProtocolError(f"a message from the master cannot be decoded: {error}") from error


def decode_component_message(frame: bytes | memoryview) -> ComponentMessage:
    """Decode what a component sent; ProtocolError where the frame is not exactly such a message."""
    try:
        return _component_decoder.decode(frame)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ProtocolError(f"a message from a component cannot be decoded: {error}") from error
