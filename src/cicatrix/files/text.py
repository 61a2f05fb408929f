"""The one reader of text that a user names, and hashes of files.

Unicode is found by its byte order mark, else by the zero bytes of the first characters (RFC 4627, section 3), else it is UTF-8.
"""

from __future__ import annotations

import codecs
import hashlib
import re
from pathlib import Path

from ..core.errors import InputError
from .opening import bytes_of, regular_file

LARGEST = 50_000_000  # bytes of a text file that is read
LEGACY = "cp1252"  # what spreadsheets of western Europe save without being asked
MARKS = {  # byte order mark: encoding; those of UTF-32 first, as that of UTF-16 begins one of them
    codecs.BOM_UTF32_LE: "utf-32-le",
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
ZEROS = {  # which of the first four bytes are zero, as the first characters of a text are ASCII
    (False, True, True, True): "utf-32-le",
    (True, True, True, False): "utf-32-be",
    (False, True, False, True): "utf-16-le",
    (True, False, True, False): "utf-16-be",
}
OFFICE = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")  # how .xlsx, .ods and .docx begin, and .xls and .doc
END_OF_DOS = "\x1a"  # that old programs write after a text
CONTROL = re.compile(r"[\x00-\x08\x0b\x0e-\x1f]")  # all but tab, line feed, form feed and carriage return


def text_of(path: Path, largest: int = LARGEST) -> str:
    """Read a text file in Unicode; its lines end in a line feed, and a byte order mark is left out.

    Raises
    ------
    InputError
        If it is not a regular file of at most ``largest`` bytes, is not text, or is in another encoding.
    """
    return _unicode(path, _bytes(path, largest))


def tolerant_text_of(path: Path, largest: int = LARGEST) -> tuple[str, list[str]]:
    """Read a text file in Unicode or, where that fails, in Windows-1252; return the text and what was assumed, in sentences.

    Only for files whose letters are names and comments, such as tables of numbers: no number depends on the guess.

    Raises
    ------
    InputError
        As :func:`text_of`, but for another encoding only if Windows-1252 cannot be it either.
    """
    data = _bytes(path, largest)
    if _encoding(data) == ("utf-8", 0) and (line := _first_odd_line(data)):
        try:
            text = _checked(path, data.decode(LEGACY))
        except UnicodeDecodeError:
            return _unicode(path, data), []  # which refuses it
        return text, [f"The table is not in UTF-8 (line {line}); its letters were read as Windows-1252 (Latin-1)."]
    return _unicode(path, data), []


def sha256_of(path: Path) -> str:
    """Hash a file's bytes; for a folder, hash the sorted hashes of its files, without their names.

    Raises
    ------
    InputError
        If a file is not a regular one or cannot be read.
    """
    if path.is_dir():
        digests = sorted(sha256_of(file) for file in path.rglob("*") if file.is_file())
        return hashlib.sha256("\n".join(digests).encode()).hexdigest()
    try:
        with regular_file(path).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


def _bytes(path: Path, largest: int) -> bytes:
    data = bytes_of(path, largest)
    if data.startswith(OFFICE):
        raise InputError(
            f"{path} is a file of an office program, not text: save it from there as CSV or plain text, in UTF-8"
        )
    return data


def _encoding(data: bytes) -> tuple[str, int]:
    """Return the encoding of Unicode text, and the length of its byte order mark."""
    for mark, encoding in MARKS.items():
        if data.startswith(mark):
            return encoding, len(mark)
    first = tuple(byte == 0 for byte in data[:4])
    return next((encoding for zeros, encoding in ZEROS.items() if zeros == first), "utf-8"), 0


def _unicode(path: Path, data: bytes) -> str:
    encoding, mark = _encoding(data)
    try:
        return _checked(path, data[mark:].decode(encoding))
    except UnicodeDecodeError as error:
        at = mark + error.start
        words = (
            f"is not a text file in {encoding[:6].upper().rstrip('-')} (line {data.count(10, 0, at) + 1}, byte {at})"
        )
        raise InputError(f"{path} {words}: save it as UTF-8") from None


def _first_odd_line(data: bytes) -> int:
    """Return the number of the first line that is not UTF-8; 0 if all are."""
    try:
        data.decode()
    except UnicodeDecodeError as error:
        return data.count(b"\n", 0, error.start) + 1
    return 0


def _checked(path: Path, text: str) -> str:
    """Return a text with its lines ended by a line feed; refuse characters that no text has."""
    text = text.replace("\r\n", "\n").replace("\r", "\n").removesuffix(END_OF_DOS)
    if found := CONTROL.search(text):
        where = f"line {text.count(chr(10), 0, found.start()) + 1}"
        raise InputError(f"{path} is not a text file: {where} has the control character U+{ord(found[0]):04X}")
    return text
