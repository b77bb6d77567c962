"""Errors that a user can fix, and text from files as it may be shown."""

import re
import unicodedata

LONGEST_SENTENCE = 400  # characters; a notice of the window has room for them
_LONGEST_WORD = 80  # what a long sentence keeps of a path or a name
_JOINERS = "\u200c\u200d"  # format characters that scripts and emoji are written with


class GagaError(Exception):
    """One plain sentence for the user: what is wrong, where, and what to do.

    Raised for bad input (a truncated file, a missing column, a full disk), never for a wrong call:
    that is a ``ValueError`` with the argument's name. The window shows it as a notice, the command
    prints it and exits with status 1. Its text may quote a file: it is made `plain_text`.
    """

    def __init__(self, text: str = "") -> None:
        super().__init__(plain_text(text))


class CancelledError(GagaError):
    """The user stopped a long task; everything is as it was before."""


def plain_text(text: str, longest: int = LONGEST_SENTENCE) -> str:
    """``text`` on one line of at most ``longest`` characters that no terminal obeys.

    Control characters, line ends, surrogates and those that turn the direction of writing are
    shown as Python escapes (``\\x1b``, ``\\u202e``). Of what is too long the longest words lose
    their middle first.
    """
    if not text.isprintable():
        text = "".join(_shown(character) for character in text)
    while len(text) > longest:
        word = max(re.findall(r"\S+", text) or [text], key=len)
        kept = min(_LONGEST_WORD, longest)
        if len(word) <= kept:
            return text[: longest - longest // 3 - 1] + "…" + text[-(longest // 3) :]
        text = text.replace(word, word[: kept // 2] + "…" + word[len(word) - kept // 2 + 1 :])
    return text


def _shown(character: str) -> str:
    kind = unicodedata.category(character)  # Unicode standard, section 4.5
    if character in _JOINERS or not (kind[0] == "C" or kind in ("Zl", "Zp")):
        return character
    return character.encode("unicode_escape").decode("ascii")
