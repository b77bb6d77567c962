"""Seeded damage to the bytes of a file."""

import json
import random
from collections.abc import Callable
from typing import Any

INTERESTING = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_ODD: tuple[object, ...] = (
    None, True, -1, 0, 1e308, -1e308, float("nan"), float("inf"), 2**31, 2**63, 2**64, 10**400,
    "", "../../x", "\0", "a" * 5000, "\ud800", [], {}, [[]], [None] * 3, {"": {}},
    -5, 2**31 - 1, 1e-310, "1", "\x1b[31m\u202e\n", "a" * 100_000, [0] * 1000, False,
)  # fmt: skip
_DEEP = 5000


def mutated(content: bytes, rng: random.Random) -> bytes:
    """Another content, damaged in one to three of the ways that files get damaged."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        ways = _TEXT_WAYS if _is_text(content) and rng.random() < 0.6 else _BYTE_WAYS
        content = rng.choice(ways)(content, rng)
    return content


def _is_text(content: bytes) -> bool:
    return content[:1] in (b"{", b"[")


def _cut(content: bytes, rng: random.Random) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _flip(content: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(content)
    for _ in range(rng.choice((1, 2, 8, 64))):
        if damaged:
            damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def _number(content: bytes, rng: random.Random) -> bytes:
    """An extreme number over some bytes, more often in the head: a length, a count, a NaN."""
    size = rng.choice((1, 2, 4, 8))
    end = len(content) if rng.random() < 0.4 else min(len(content), 512)
    at = rng.randrange(max(end, 1))
    value = rng.choice(INTERESTING)
    raw = rng.choice((value.to_bytes(8, "little"), value.to_bytes(8, "big"), b"\0\0\xc0\x7f" * 2))
    return content[:at] + raw[:size] + content[at + size :]


def _move(content: bytes, rng: random.Random) -> bytes:
    """A piece taken out, doubled, or put elsewhere."""
    a, b = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    piece, at = content[a:b][:4096], rng.randrange(len(content) + 1)
    if rng.random() < 0.5:
        content = content[:a] + content[b:]
    return content[:at] + piece + content[at:]


def _digits(content: bytes, rng: random.Random) -> bytes:
    """A number of a text header or file replaced."""
    starts = [i for i, byte in enumerate(content[:20_000]) if chr(byte).isdecimal()]
    if not starts:
        return _flip(content, rng)
    at = end = rng.choice(starts)
    while end < len(content) and chr(content[end]).isdecimal():
        end += 1
    number = rng.choice((b"0", b"-1", b"9" * 30, b"4294967296", b"nan", b"1e999", b"", b"99999999"))
    return content[:at] + number + content[end:]


def with_wrong_value(content: bytes, rng: random.Random) -> bytes:
    """A value of a JSON file, wherever it is, replaced by one of another type or size.

    Or its key is removed or there twice, or its list longer, or its number another one.
    """
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return _flip(content, rng)
    places: list[tuple[Any, Any]] = []
    open_nodes: list[Any] = [document] if isinstance(document, dict | list) else []
    while open_nodes and len(places) < 3000:
        node = open_nodes.pop()
        items = node.items() if isinstance(node, dict) else enumerate(node)
        for key, value in items:
            places.append((node, key))
            if isinstance(value, dict | list):
                open_nodes.append(value)
    if not places:
        return json.dumps(rng.choice(_ODD)).encode()
    node, key = rng.choice(places)
    value, way = node[key], rng.random()
    if isinstance(node, dict) and way < 0.15:
        del node[key]
    elif isinstance(node, dict) and way < 0.25:
        twice = f"{key} twice"
        text = json.dumps({**document, twice: rng.choice(_ODD)} if node is document else document)
        return text.replace(json.dumps(twice), json.dumps(key)).encode()
    elif isinstance(value, list) and way < 0.5:
        node[key] = rng.choice((value * 2, value[:-1], value[::-1], [value], value[:1] * 1000))
    elif isinstance(value, int | float) and way < 0.5 and abs(value) < 1e300:
        node[key] = rng.choice((-value, value + 1, value * 1e6, str(value), [value], float(value)))
    else:
        node[key] = rng.choice(_ODD)
    return json.dumps(document).encode()


def _nest(content: bytes, rng: random.Random) -> bytes:
    """Deep nesting, at the start or in the place of a value."""
    opening = rng.choice((b"[", b'{"a":'))
    at = content.find(b":", rng.randrange(len(content) + 1)) + 1
    return content[:at] + opening * rng.choice((50, _DEEP)) + content[at:]


_Way = Callable[[bytes, random.Random], bytes]
_BYTE_WAYS: tuple[_Way, ...] = (_cut, _flip, _flip, _number, _number, _move, _digits)
_TEXT_WAYS: tuple[_Way, ...] = (with_wrong_value,) * 3 + (_nest, _digits)
