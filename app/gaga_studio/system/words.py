"""Every text of the window in the user's language: one file a language, looked up by the English.

Texts are written in English where they are used. ``assets/strings/en.json`` lists all of them, with
a field in braces for what differs from time to time: "Found {n} objects.". A translation is the
same file under another name with other values; one in ``strings`` of the user's own folder
(`paths.home`) is found too. What it lacks stays English.
"""

import json
import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from gaga_studio.system import paths

_LOG = logging.getLogger(__name__)
ENGLISH = "en"
NAME = "@language"  # the language's own name for itself
_DOT = "  ·  "  # joins facts in one line
_FIELD = re.compile(r"\{(\w+)\}")
_AROUND = re.compile(r"^([\s\ue000-\uf8ff]*)(.*?)(\s*)$", re.DOTALL)  # icons before, blanks after


@dataclass(frozen=True)
class _Template:
    """A text with fields: what stands before the first and after the last, and all of it."""

    start: str
    end: str
    pattern: re.Pattern[str]
    translation: str


@dataclass(frozen=True)
class _Language:
    name: str = ENGLISH
    texts: Mapping[str, str] | None = None  # None: English
    templates: tuple[_Template, ...] = ()  # those with the longest fixed text first


class _Used:
    """The language in use, of the whole program."""

    language = _Language()


def languages() -> dict[str, str]:
    """Every language that there is a file of, with its own name: {"en": "English"}."""
    found = {ENGLISH: "English"}
    for file in _files():
        found[file.stem] = _read(file).get(NAME, file.stem)
    return found


def use(name: str) -> bool:
    """Speak this language from now on; whether that changed anything. English where it is none."""
    if name == _Used.language.name:
        return False
    file = next((f for f in _files() if f.stem == name), None)
    if name == ENGLISH or file is None:
        _Used.language = _Language(name)
    else:
        _Used.language = _language(name, _read(file))
    _translated.cache_clear()
    return True


def is_english() -> bool:
    """Whether nothing needs to be looked up."""
    return _Used.language.texts is None


def tr(text: str) -> str:
    """``text`` in the language in use; icons and blanks around it stay. English when unknown."""
    return text if _Used.language.texts is None or not text else _translated(text)


def listed(text: str) -> str:
    """``text`` as it is; the call puts it into the catalogue, even if it looks like no sentence."""
    return text


def label(text: str) -> str:
    """The label of a control in the language in use, under its English identity ("…###Close")."""
    if _Used.language.texts is None:
        return text
    shown, mark, _ = text.partition("##")
    translated = tr(shown)
    if translated == shown:
        return text
    identity = text.partition("###")[2] if "###" in text else text if mark else shown
    return f"{translated}###{identity}"


@lru_cache(maxsize=4096)
def _translated(text: str) -> str:
    language = _Used.language
    match = _AROUND.match(text)
    if language.texts is None or match is None or not match[2]:
        return text
    whole = language.texts.get(match[2])
    if whole is None and _DOT in match[2]:
        whole = _DOT.join(_translated(piece) for piece in match[2].split(_DOT))
    if whole is None:
        whole = _filled(match[2], language.templates)
    return match[1] + whole + match[3]


def _filled(text: str, templates: tuple[_Template, ...]) -> str:
    """The translation of the template that ``text`` was made of; what fills it, in turn."""
    for template in templates:
        if text.startswith(template.start) and text.endswith(template.end):
            found = template.pattern.fullmatch(text)
            if found is not None:
                fields = {name: _translated(value) for name, value in found.groupdict().items()}
                return _FIELD.sub(
                    lambda m, fields=fields: fields.get(m[1], m[0]),  # type: ignore[misc]
                    template.translation,
                )
    return text


def _language(name: str, texts: Mapping[str, str]) -> _Language:
    # The longest fixed text first: what says most of it is what it was made of.
    keys = sorted(filter(_FIELD.search, texts), key=lambda key: -len(_FIELD.sub("", key)))
    return _Language(name, texts, tuple(_template(key, texts[key]) for key in keys))


def _template(text: str, translation: str) -> _Template:
    parts = _FIELD.split(text)  # fixed, name, fixed, name, fixed
    pattern = "".join(
        f"(?P<{part}>.+?)" if i % 2 else re.escape(part) for i, part in enumerate(parts)
    )
    return _Template(parts[0], parts[-1], re.compile(pattern, re.DOTALL), translation)


def _files() -> list[Path]:
    """The files of all languages; the user's own win."""
    found = {}
    for folder in (paths.assets() / "strings", paths.home() / "strings"):
        found.update({file.stem: file for file in sorted(folder.glob("*.json"))})
    return list(found.values())


def _read(file: Path) -> dict[str, str]:
    """The texts of a file; none when it is damaged, which the log says."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        _LOG.warning("strings %s: %s", file, error)
        return {}
    if not isinstance(content, dict):
        return {}
    return {key: value for key, value in content.items() if isinstance(value, str) and value}
