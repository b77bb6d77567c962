"""Errors that a user can fix, text from files as it may be shown, and names of options in both."""

import logging
import re
import sys
import unicodedata
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

LONGEST_SENTENCE = 400  # characters; a notice of the window has room for them
LONGEST_LINE = 10_000  # characters of a line of output or of the log: 50 lines of 200 columns
_LONGEST_WORD = 80  # what a long sentence keeps of a path or a name
_OF_MODELS = ("models", "simulation", "usd")  # extras that the folder of `make app-models` has
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


def cure_without(extra: str) -> str:
    """How to install the packages of an optional ``extra``: what follows "Install it: ".

    The program of `make app` has no pip: it finds packages in its folder of models alone.
    """
    pip = f"pip install 'gaga-studio[{extra}]'"
    if not getattr(sys, "frozen", False):
        return pip
    if extra in _OF_MODELS:
        return f"put the folder of make app-models at {Path(sys.executable).parent / 'models'}"
    return f"this program folder cannot have it, a Python of your own can: {pip}"


def plain_text(text: str, longest: int = LONGEST_SENTENCE) -> str:
    """``text`` on one line of at most ``longest`` characters that no terminal obeys.

    Control characters, line ends, surrogates and those that turn the direction of writing are
    shown as Python escapes (``\\x1b``, ``\\u202e``). Of what is too long the longest words lose
    their middle first.
    """
    text = _shortened(text, longest)
    if not text.isprintable():
        text = _shortened("".join(_shown(character) for character in text), longest)
    return text


def decimal_text(value: float, digits: int = 3) -> str:
    """A number of so many digits in a sentence for the user: "0.00000463", "1230000"."""
    return format(Decimal(f"{value:.{digits}g}"), "f")


def counted(n: int, noun: str) -> str:
    """How many of what, in a sentence for the user: "1 splat", "5,999 loose splats"."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


class PlainFormatter(logging.Formatter):
    """Writes records of the log as `plain_text`: they quote files, too."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  the base's name
        """One line."""
        return plain_text(super().formatMessage(record), LONGEST_LINE)

    def formatException(self, ei: Any) -> str:  # noqa: N802  the base's name
        """The lines of a traceback."""
        lines = super().formatException(ei).split("\n")
        return "\n".join(plain_text(line, LONGEST_LINE) for line in lines)


def _shortened(text: str, longest: int) -> str:
    """Without the middle of its longer words, half of them at a time, then of the whole."""
    kept = min(_LONGEST_WORD, longest)
    while len(text) > longest:
        lengths = sorted((len(word) for word in re.findall(r"\S+", text)), reverse=True)
        lengths = [length for length in lengths if length > kept]
        if not lengths:
            return text[: longest - longest // 3 - 1] + "…" + text[-(longest // 3) :]
        least = lengths[(len(lengths) - 1) // 2]
        # Each word is looked at once: \S{least,} would begin again at each of its letters.
        text = re.sub(r"\S+", partial(_cut, kept=kept, least=least), text)
    return text


def _cut(found: re.Match[str], kept: int, least: int) -> str:
    word = found[0]
    if len(word) < least:
        return word
    return word[: kept // 2] + "…" + word[len(word) - kept // 2 + 1 :]


def _shown(character: str) -> str:
    kind = unicodedata.category(character)  # Unicode standard, section 4.5
    if character in _JOINERS or not (kind[0] == "C" or kind in ("Zl", "Zp")):
        return character
    return character.encode("unicode_escape").decode("ascii")


# --- Names of the options that messages recommend, in the command and in the window.
# The window's names are those of its sheet "Make splats" (Settings next to the offer).


IN_WINDOW = {
    "--quality": "Quality",
    "--focal": "Focal length, pixels",
    "--video-fps": "Frames of each second",
    "--foreground": "Masks of the object",
    "--turntable": "Object on a turntable",
    "--poses": "Poses next to the photos",
    "--poses-from": "File of the poses",
    "--scene": "Scene",
    "--place-minutes": "Minutes for placing",
}
QUALITY_TITLES = {"draft": "Quick look", "standard": "Good", "full": "Best"}  # names in the window


def option(name: str, value: str = "") -> str:
    """``name`` with its control: "--quality standard (Quality in the window's settings)"."""
    shown = f"{name} {value}".strip()
    return f"{shown} ({IN_WINDOW[name]} in the window's settings)"


def in_window(text: str) -> str:
    """A message as the window says it: "Quality: Best in Settings" for an `option`."""

    def control(found: re.Match[str]) -> str:
        value, name = found[1], found[2]
        return (
            f"{name}: {QUALITY_TITLES.get(value, value)} in Settings"
            if value
            else f"{name} in Settings"
        )

    text = re.sub(r"--[a-z-]+(?: (\S+))? \(([^()]*) in the window's settings\)", control, text)
    return re.sub(r"gaga models get (\S+) \(Models in the window\)", r"\1, in Find, Models", text)
