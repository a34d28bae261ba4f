"""The messages that a client sends: built here, sent elsewhere."""

from __future__ import annotations

import enum
from typing import Any, Iterator, Optional, Tuple, Union

import numpy as np
from numpy.typing import NDArray

from barycast.v1 import barycast_pb2, cage_pb2

from . import arrays
from .cage import Cage, Faces
from .errors import MissingCageError

_UPLOAD_PIECE_BYTES = 1 << 20
_BLOCK_ITEMS = 65536  # points or faces of one message: 1.5 MiB of float64 points
_MESSAGE_BYTES_SPARE = 4096  # for the fields around an array

Metadata = Tuple[Tuple[str, str], ...]


def digest_metadata(cage: Cage) -> Metadata:
    """The cage's name as plain metadata, so that a balancer can send a cage's requests to one replica."""
    return (("x-cage-digest", cage.digest.sha256.hex()),)


class _By(enum.Enum):
    DIGEST = 1
    UPLOAD_THEN_DIGEST = 2
    INLINE = 3


class CageNaming:
    """How requests name their cage: by its digest; after an upload, when the server does not hold it; by the cage
    itself, when it (or another replica) then still does not."""

    def __init__(self, cage: Cage) -> None:
        self._cage = cage
        self._by = _By.DIGEST

    @property
    def uploads(self) -> bool:
        """Whether the cage must be uploaded before the next request."""
        return self._by is _By.UPLOAD_THEN_DIGEST

    def name(self, message: Union[barycast_pb2.ComputeHeader, barycast_pb2.EstimateCostRequest]) -> None:
        """Puts the cage, or its name, into the message."""
        if self._by is _By.INLINE:
            message.inline_cage.CopyFrom(self._cage.to_message())
            if isinstance(message, barycast_pb2.ComputeHeader):
                message.expected_digest.CopyFrom(self._cage.digest)
        else:
            message.cage_digest.CopyFrom(self._cage.digest)

    def found(self) -> None:
        """The server answered: it need not be given the cage again."""
        if self._by is _By.UPLOAD_THEN_DIGEST:
            self._by = _By.DIGEST

    def missing(self, error: MissingCageError) -> None:
        """The server does not hold the cage; throws the error when nothing is left to try."""
        if self._by is _By.INLINE:
            raise error
        self._by = _By(self._by.value + 1)


def upload_pieces(cage: Cage, fill_tables: bool = False) -> Iterator[barycast_pb2.UploadCageRequest]:
    """The cage in pieces; the digest, and what else to do, travel with the first."""
    data = cage.to_message().SerializeToString()
    digest: Optional[cage_pb2.CageDigest] = cage.digest
    for begin in range(0, len(data), _UPLOAD_PIECE_BYTES):
        yield barycast_pb2.UploadCageRequest(expected_digest=digest, fill_tables=fill_tables and begin == 0,
                                             piece=data[begin:begin + _UPLOAD_PIECE_BYTES])
        digest = None


def query_set(point_count: int, faces: Faces) -> barycast_pb2.QuerySet:
    """The announced sizes."""
    return barycast_pb2.QuerySet(point_count=point_count, face_count=len(faces), corner_count=len(faces.corners))


def compute_requests(header: barycast_pb2.ComputeHeader, points: NDArray[Any], faces: Faces, message_bytes_max: int
                     ) -> Iterator[barycast_pb2.ComputeCoordinatesRequest]:
    """The header, then points and faces in blocks of at most message_bytes_max bytes (or one item)."""
    yield barycast_pb2.ComputeCoordinatesRequest(header=header)

    room = max(1, message_bytes_max - _MESSAGE_BYTES_SPARE)
    step = max(1, min(_BLOCK_ITEMS, room // (points.shape[1] * points.itemsize)))
    for begin in range(0, len(points), step):
        block = barycast_pb2.PointBlock(points=arrays.to_message(points[begin:begin + step]))
        yield barycast_pb2.ComputeCoordinatesRequest(points=block)

    begin = 0
    words = faces.offsets + np.arange(len(faces) + 1)  # uint32 up to each face: its corners and its count
    while begin < len(faces):
        fits = int(np.searchsorted(words, words[begin] + room // 4, side="right")) - 1
        end = max(begin + 1, min(fits, begin + _BLOCK_ITEMS))
        corners = faces.corners[faces.offsets[begin]:faces.offsets[end]]
        face_block = barycast_pb2.FaceBlock(
            corner_counts=arrays.to_message(faces.counts[begin:end].astype(np.uint32)),
            corners=arrays.to_message(corners))
        yield barycast_pb2.ComputeCoordinatesRequest(faces=face_block)
        begin = end
