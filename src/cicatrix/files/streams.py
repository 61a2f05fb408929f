"""Bytes of a file, plain or compressed, read up to what its header asks for."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from ..core.errors import InputError
from .opening import regular_file

GZIP = b"\x1f\x8b"
PIECE = 1 << 24  # bytes read at once, so that a short file is noticed before its whole size is allocated
LONGEST_LINE = 1 << 20
LONGEST_SKIP = 1 << 30  # bytes between a header and its voxels
MOST_LINES = 1_000_000  # lines that a header may ask to leave out
TOO_LONG = "the file holds more bytes than its header says, so one of the two is damaged; convert it again"
DAMAGED = "the file is cut short or damaged; copy it again from its source"


class Source:
    """A stream of bytes whose faults are an `InputError`; make it by :func:`opened`."""

    def __init__(self, stream: IO[bytes]):
        self._stream = stream

    def read(self, n: int) -> bytearray:
        """Return the next ``n`` bytes.

        Raises
        ------
        InputError
            If there are fewer, or they are damaged.
        """
        data = bytearray()
        while len(data) < n:
            piece = self.some(min(n - len(data), PIECE))
            if not piece:
                raise InputError(DAMAGED)
            data += piece
        return data

    def skip(self, n: int) -> None:
        """Leave out the next ``n`` bytes, which are not kept.

        Raises
        ------
        InputError
            If there are fewer, they are damaged, or ``n`` is more than `LONGEST_SKIP`.
        """
        if n > LONGEST_SKIP:
            raise InputError(
                f"the header puts the voxels behind {n:,} bytes, and at most {LONGEST_SKIP:,} can be left out; convert it again"
            )
        while n > 0:
            piece = self.some(min(n, PIECE))
            if not piece:
                raise InputError(DAMAGED)
            n -= len(piece)

    def some(self, n: int) -> bytes:
        """Return at most ``n`` of the next bytes; none at the end."""
        with _damage():
            return self._stream.read(n)

    def line(self) -> str:
        """Return the next line of a header without its end; nothing at the end of the file, or where an empty line is."""
        with _damage():
            line = self._stream.readline(LONGEST_LINE)
        if len(line) == LONGEST_LINE:
            raise InputError(DAMAGED)
        return line.decode("utf-8", "replace").strip()

    def rest(self, most: int) -> bytearray:
        """Return the bytes up to the end.

        Raises
        ------
        InputError
            If there are more than ``most``.
        """
        data = bytearray()
        while piece := self.some(PIECE):
            data += piece
            if len(data) > most:
                raise InputError(TOO_LONG)
        return data

    def last(self, n: int) -> bytearray:
        """Return the last ``n`` bytes of the file; those before them are read in pieces and dropped."""
        data = bytearray()
        while piece := self.some(PIECE):
            data += piece
            del data[:-n]
        if len(data) < n:
            raise InputError(DAMAGED)
        return data

    def finish(self) -> None:
        """Read on to the end, where a checksum is compared.

        Raises
        ------
        InputError
            If the checksum is another, or the file holds more than the header says.
        """
        if self.some(1):
            raise InputError(TOO_LONG)

    def unpacked(self, encoding: str) -> Source:
        """Return the rest of this stream, unpacked; ``encoding`` is gzip, zlib (with either header), bzip2 or raw."""
        if encoding == "gzip":
            return Source(gzip.GzipFile(fileobj=self._stream))  # pyright: ignore[reportArgumentType]
        if encoding == "bzip2":
            return Source(bz2.BZ2File(self._stream))
        return Source(io.BufferedReader(_Inflated(self._stream))) if encoding == "zlib" else self


class _Inflated(io.RawIOBase):
    """Zlib or gzip data, inflated while they are read; they must end with their checksum."""

    def __init__(self, stream: IO[bytes]):
        self._stream, self._inflate = stream, zlib.decompressobj(47)  # 47: either header, largest window

    def readable(self) -> bool:
        return True

    def readinto(self, buffer) -> int:
        """Fill ``buffer`` as far as one step of inflation does, and return how many bytes it gave."""
        while not self._inflate.eof:
            packed = self._inflate.unconsumed_tail or self._stream.read(1 << 16)
            if not packed:
                raise EOFError
            out = self._inflate.decompress(packed, len(buffer))
            if out:
                buffer[: len(out)] = out
                return len(out)
        return 0


@contextlib.contextmanager
def opened(path: Path, *, as_is: bool = False) -> Iterator[Source]:
    """Open a regular file; what begins as gzip is unpacked, whatever the file's name, unless the bytes are wanted ``as_is``.

    Raises
    ------
    InputError
        If it is no regular file, or cannot be read.
    """
    try:
        file = regular_file(path).open("rb")
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}") from None
    with file:
        packed = not as_is and file.read(2) == GZIP
        file.seek(0)
        source = Source(file)
        yield source.unpacked("gzip") if packed else source


@contextlib.contextmanager
def _damage() -> Iterator[None]:
    """Replace what the libraries raise at damaged data by one sentence."""
    try:
        yield
    except (EOFError, OSError, ValueError, zlib.error):
        raise InputError(DAMAGED) from None
