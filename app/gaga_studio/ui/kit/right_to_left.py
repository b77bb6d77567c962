"""Names in Arabic and Hebrew script, in the order and the shapes in which they are read.

The toolkit draws letters from left to right as they are stored. Here runs of right-to-left letters
are turned around, and Arabic letters take the form that their neighbours ask for. Numbers and Latin
words inside keep their direction. That is enough for names, not for paragraphs (UAX 9 has more).
"""

import unicodedata
from functools import cache, lru_cache

_RIGHT = ("R", "AL")
_MARKS = ("NSM",)
_MIRRORED = str.maketrans("()[]{}<>«»", ")(][}{><»«")
# Presentation forms: isolated, final, initial, medial.
_FORMS = ("<isolated>", "<final>", "<initial>", "<medial>")


@lru_cache(maxsize=4096)
def visual(text: str) -> str:
    """``text`` in the order in which it is drawn, left to right."""
    if text.isascii() or not any(unicodedata.bidirectional(c) in _RIGHT for c in text):
        return text
    kinds = (unicodedata.bidirectional(letter) for letter in text)
    is_right = next(kind in _RIGHT for kind in kinds if kind in (*_RIGHT, "L"))
    runs = _runs(_shaped(text), is_right)
    drawn = [run[::-1].translate(_MIRRORED) if turns else run for run, turns in runs]
    return "".join(reversed(drawn) if is_right else drawn)


def _runs(text: str, whole_is_right: bool) -> list[tuple[str, bool]]:
    """Parts of one direction, and whether that is from the right; what is neutral takes that of
    both its sides, where they differ that of the whole."""
    runs: list[tuple[str, bool]] = []
    for i, letter in enumerate(text):
        kind = unicodedata.bidirectional(letter)
        before = runs[-1][1] if runs else whole_is_right
        if kind in _RIGHT:
            is_right = True
        elif kind in ("L", "EN", "AN"):
            is_right = False
        elif kind in _MARKS:
            is_right = before
        else:
            after = _next_is_right(text, i, whole_is_right)
            is_right = before if before == after else whole_is_right
        if runs and runs[-1][1] == is_right:
            runs[-1] = (runs[-1][0] + letter, is_right)
        else:
            runs.append((letter, is_right))
    return runs


def _next_is_right(text: str, at: int, at_end: bool) -> bool:
    kinds = (unicodedata.bidirectional(letter) for letter in text[at:])
    return next((kind in _RIGHT for kind in kinds if kind in (*_RIGHT, "L", "EN", "AN")), at_end)


def _shaped(text: str) -> str:
    """Arabic letters in the form for their place in the word."""
    forms, shaped = _forms(), []
    for i, letter in enumerate(text):
        if letter not in forms:
            shaped.append(letter)
            continue
        joins_before = i > 0 and "<initial>" in forms.get(text[i - 1], {})
        joins_after = i + 1 < len(text) and "<final>" in forms.get(text[i + 1], {})
        place = _FORMS[2 * joins_after + joins_before]
        own = forms[letter]
        shaped.append(own.get(place) or own.get(_FORMS[int(joins_before)]) or letter)
    return "".join(shaped)


@cache
def _forms() -> dict[str, dict[str, str]]:
    """Presentation forms of Arabic letters (U+FB50 to U+FEFF) by letter and place."""
    forms: dict[str, dict[str, str]] = {}
    for code in (*range(0xFB50, 0xFBC2), *range(0xFE80, 0xFEFD)):
        parts = unicodedata.decomposition(chr(code)).split()
        if len(parts) == 2 and parts[0] in _FORMS:
            forms.setdefault(chr(int(parts[1], 16)), {})[parts[0]] = chr(code)
    return forms
