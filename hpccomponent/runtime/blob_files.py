"""The blobs that a component keeps, each in a memory file that its worker process maps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hpccomponent.protocol.blobs import check_blob
from hpccomponent.protocol.frames import Buffer, group_frames
from hpccomponent.protocol.messages import Forget, Share, encode_message
from hpccomponent.runtime.channel import Channel, MemoryFile


def check_share(share: Share, frames: Sequence[Buffer]) -> None:
    """Raise ProtocolError where the frames are not those of the blob that a message announces."""
    check_blob(share.key, share.header, share.sizes, group_frames(frames, share.sizes))


class BlobFiles:
    """Memory files by the key of what is in them; which to keep is the session's choice."""

    def __init__(self) -> None:
        self._files: dict[bytes, MemoryFile] = {}

    def keep(self, share: Share, frames: Sequence[Buffer]) -> None:
        """Copy a blob out of its frames, once for all tasks; OSError where there is no memory."""
        pieces = group_frames(frames, share.sizes)
        self._files[share.key] = MemoryFile(encode_message(share), pieces)

    def hand_over(self, keys: Iterable[bytes], channel: Channel) -> None:
        """Let the worker process map these blobs; errors are those of `Channel.send_file`."""
        for key in keys:
            channel.send_file(self._files[key])

    def discard(self, keys: Sequence[bytes], session: str, channel: Channel | None) -> None:
        """Let blobs go, here and in the worker process; ChannelClosedError where that is gone."""
        for key in keys:
            self._files.pop(key).close()
        if channel is not None:
            channel.send(encode_message(Forget(session, list(keys))), [])

    def close(self) -> None:
        """Free all memory."""
        self.discard(list(self._files), "", None)
