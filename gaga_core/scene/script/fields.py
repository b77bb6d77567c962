"""Checks of the fields of an edit script: each returns the value or raises one plain sentence."""

from collections.abc import Callable

from gaga_core.errors import GagaError

Value = float | int | str | bool | tuple["Value", ...]
_LARGEST = 1e18  # products of three stay finite in float64, and values in float32
Check = Callable[[str, object], Value]  # (where, value) -> checked value


def number(where: str, value: object) -> float:
    """A finite number."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not -_LARGEST <= value <= _LARGEST:  # type: ignore[operator]
        raise GagaError(f"{where} must be a number up to {_LARGEST:g}, not {_short(value)}.")
    return float(value)  # type: ignore[arg-type]


def share(where: str, value: object) -> float:
    """A number 0..1."""
    checked = number(where, value)
    if not 0 <= checked <= 1:
        raise GagaError(f"{where} must lie between 0 and 1, not {_short(value)}.")
    return checked


def signed_share(where: str, value: object) -> float:
    """A number -1..1."""
    checked = number(where, value)
    if not -1 <= checked <= 1:
        raise GagaError(f"{where} must lie between -1 and 1, not {_short(value)}.")
    return checked


def count(where: str, value: object) -> int:
    """A whole number of at least 1."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise GagaError(f"{where} must be a whole number of at least 1, not {_short(value)}.")
    return value


def flag(where: str, value: object) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise GagaError(f"{where} must be true or false, not {_short(value)}.")
    return value


def name(where: str, value: object) -> str:
    """A text of at most 200 characters."""
    if not isinstance(value, str) or len(value) > 200:
        raise GagaError(f"{where} must be a text of at most 200 characters, not {_short(value)}.")
    return value


def how(where: str, value: object) -> str:
    """A way to change the selection."""
    if value not in ("set", "add", "remove", "intersect"):
        raise GagaError(f"{where} must be set, add, remove or intersect, not {_short(value)}.")
    return str(value)


def label_source(where: str, value: object) -> str:
    """Where labels come from."""
    if value not in ("votes", "identities"):
        raise GagaError(f"{where} must be votes or identities, not {_short(value)}.")
    return str(value)


def vector(where: str, value: object) -> Value:
    """Three finite numbers."""
    if not isinstance(value, list) or len(value) != 3:
        raise GagaError(f"{where} must be a list of 3 numbers, not {_short(value)}.")
    return tuple(number(where, item) for item in value)


def color(where: str, value: object) -> Value:
    """Red, green, blue, each 0..1."""
    vector(where, value)
    assert isinstance(value, list)
    return tuple(share(where, item) for item in value)


def factors(where: str, value: object) -> Value:
    """One positive number, or three."""
    checked = vector(where, value) if isinstance(value, list) else number(where, value)
    parts = checked if isinstance(checked, tuple) else (checked,)
    if not all(isinstance(part, float) and part > 0 for part in parts):
        raise GagaError(f"{where} must be above 0, not {_short(value)}.")
    return checked


def matrix(where: str, value: object) -> Value:
    """Three rows of four finite numbers."""
    rows = value if isinstance(value, list) else []
    if len(rows) != 3 or not all(isinstance(row, list) and len(row) == 4 for row in rows):
        raise GagaError(f"{where} must be 3 rows of 4 numbers, not {_short(value)}.")
    return tuple(tuple(number(where, item) for item in row) for row in rows)


def points(where: str, value: object) -> Value:
    """Three points of three finite numbers."""
    if not isinstance(value, list) or len(value) != 3:
        raise GagaError(f"{where} must be 3 points, not {_short(value)}.")
    return tuple(vector(where, item) for item in value)


def group_list(where: str, value: object) -> Value:
    """Group ids or names, at least one."""
    items = value if isinstance(value, list) else []
    good = [
        isinstance(item, str) or (isinstance(item, int) and not isinstance(item, bool))
        for item in items
    ]
    if not items or not all(good):
        raise GagaError(f"{where} must be a list of group ids or names, not {_short(value)}.")
    return tuple(items)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
