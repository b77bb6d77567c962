"""Reading the JSON files that gaga-studio writes: typed, bounded, one sentence on any failure."""

import json
import os
import re
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec

from gaga_core.errors import GagaError
from gaga_core.io.files import check_memory, explain_os_error, open_file

T = TypeVar("T")
PathText = Annotated[str, msgspec.Meta(pattern="^[^\\x00]*$", max_length=4096)]  # a path in a file
MOST_BYTES = 64 << 20  # of a file of our own; a project of 100,000 named groups has 4 MB
# Bytes that Python's values and the structs made of them take at most, for each of these in a file.
_VALUE_BYTES = {b",": 40, b"[": 100, b"{": 320, b'"': 16}
_TEXT_TIMES = 5  # the file's own size: its bytes, and text of four bytes a character
_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")
_FIELD = re.compile(r"^(?P<what>.*?) - at `\$\.?(?P<field>[^`]*)`$", re.DOTALL)


def read_json(path: Path, kind: type[T], cure: str, *, most_bytes: int = MOST_BYTES) -> T:
    """Read the JSON file ``path`` as ``kind``, a `msgspec.Struct` or a type that msgspec knows.

    Numbers that are not finite or do not fit 64 bits, nesting beyond the interpreter's limit and
    files of more than ``most_bytes`` are refused. Raises ``GagaError`` with one sentence that names
    the file and the field; ``cure`` says what to do then.
    """
    return decode_json(read_bytes(path, cure, most_bytes), kind, str(path), cure)


def read_bytes(path: Path, cure: str, most_bytes: int) -> bytes:
    """Read a file of at most ``most_bytes``; ``GagaError`` when it has more, or cannot be read."""
    try:
        with open_file(path) as file:
            size = os.fstat(file.fileno()).st_size  # as much memory is taken as is asked for
            raw = file.read(min(size, most_bytes) + 1)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    if len(raw) > most_bytes:
        raise GagaError(
            f"{path} has more than {most_bytes >> 20} MB, too much for a file of its kind. {cure}"
        )
    return raw


def decode_json(raw: bytes, kind: type[T], where: str, cure: str) -> T:
    """Decode JSON bytes as ``kind``, with the checks and the errors of `read_json`.

    ``where`` names the source in the sentence.
    """
    try:
        return msgspec.json.decode(raw, type=kind)
    except (msgspec.MsgspecError, ValueError, RecursionError, MemoryError) as error:
        raise GagaError(f"{where} is damaged ({explain_json_error(error)}). {cure}") from error


def read_foreign_json(path: Path, kind: type[T], *, most_bytes: int = MOST_BYTES) -> T:
    """Read a JSON file that other programs write too as ``kind``, figures NaN included.

    Raises ``GagaError`` with one sentence when it cannot be read, has another form, or would take
    too much memory (`check_memory`).
    """
    raw = read_bytes(path, "", most_bytes)
    counts = {sign: raw.count(sign) for sign in _VALUE_BYTES}
    n_bytes = sum(n * _VALUE_BYTES[sign] for sign, n in counts.items()) + _TEXT_TIMES * len(raw)
    check_memory(path, n_bytes, f"{counts[b',']:,} values")
    try:
        content = json.loads(raw)
        if _SURROGATE.search(raw):  # half of a pair is no text: nothing could print or write it
            json.dumps(content, ensure_ascii=False).encode()
    except (ValueError, RecursionError, MemoryError) as error:
        why = explain_json_error(error)
        raise GagaError(f"{path} is damaged: it is not JSON ({why}). Copy it again.") from error
    return convert_json(content, kind, str(path))


def convert_json(content: object, kind: type[T], where: str) -> T:
    """JSON values as ``kind``; ``GagaError`` in one sentence with ``where`` and the field."""
    try:
        return msgspec.convert(content, kind)
    except (msgspec.ValidationError, OverflowError, RecursionError) as error:
        raise GagaError(
            f"{where} is damaged ({explain_json_error(error)}). Copy it again."
        ) from error


def explain_json_error(error: Exception) -> str:
    """Say what is wrong with a JSON value, with the field where it is known."""
    if isinstance(error, RecursionError):
        return "it is nested too deep"
    if isinstance(error, MemoryError):
        return "it is too large"
    text = str(error).replace("`", "")
    found = _FIELD.match(str(error))
    if found is None:
        return text
    what = found["what"].replace("`", "")
    return f"field {found['field']}: {what[:1].lower()}{what[1:]}" if found["field"] else what
