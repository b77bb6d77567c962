"""Makes ``assets/strings/en.json``: every text that a person can read in the window.

Run with --write after a text was added or changed: ``python -m tests.strings --write``. A test
compares the file with what the source says.
"""

import ast
import json
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from gaga_studio.system.words import ENGLISH, NAME

ROOT = Path(__file__).resolve().parents[1]
CATALOGUE = ROOT / "assets" / "strings" / f"{ENGLISH}.json"

# Calls whose texts nobody reads in the window.
_SILENT = re.compile(
    r"_LOG\.\w+|logging\.\w+|re\.\w+|\w*\.?(getLogger|getattr|setattr|hasattr|push_id|get|index"
    r"|startswith|endswith|removeprefix|removesuffix|strip|rstrip|lstrip|split|rpartition"
    r"|partition|encode|decode|replace|count|environ|open|read_text|write_text|fromhex|glob"
    r"|bind_to_image|create_context|RuntimeError|ValueError|KeyError|TypeError|AssertionError"
    r"|NamedTemporaryFile|Thread|ThreadPoolExecutor|begin_child|begin_table|invisible_button"
    r"|program|DockingSplit|has_glyph|dtype|array|import_module|find_spec|request|_answer)"
)
# Calls in gaga_core whose texts reach the window.
_HEARD = {"GagaError", "Progress", "part", "warn"}
# Calls whose texts are read whatever they look like.
_SAID = re.compile(r"words\.listed|.*\.add_text")
_TITLES = {"title", "verb", "note", "notes", "warning"}
_SHORTCUT = re.compile(r"((Ctrl|Shift|Alt)\+)+\S+|F\d+|[A-Z]")
_PLACES = {  # titles that are names of places, not texts
    "MainDockSpace", "Bottom", "BottomRight", "Left", "Right", "RightBottom", "RightDown",
    "Wide", "Compact", "Viewport", "Question", "AppData", "Notice {slot}",
}  # fmt: skip


def texts() -> dict[str, str]:
    """Every text, English to English, in alphabetical order."""
    found: set[str] = set()
    for file in sorted((ROOT / "app" / "gaga_studio").rglob("*.py")):
        if "gpu" not in file.parts:
            found |= set(_of_window(ast.parse(file.read_text(encoding="utf-8"))))
    for file in sorted((ROOT / "gaga_core").rglob("*.py")):
        if not file.name.startswith("cli"):
            found |= set(_of_core(ast.parse(file.read_text(encoding="utf-8"))))
    return {NAME: "English", **{text: text for text in sorted(found)}}


def content() -> str:
    """The file as it must be."""
    return json.dumps(texts(), indent=0, ensure_ascii=False) + "\n"


def pseudo(text: str) -> str:
    """English that looks foreign: accents, and a third longer; fields stay."""
    parts = re.split(r"(\{\w+\})", text)
    plain = str.maketrans("aceinosuyACEINOSUY", "áçéíñöšüýÁÇÉÍÑÖŠÜÝ")
    changed = "".join(p if i % 2 else p.translate(plain) for i, p in enumerate(parts))
    return f"{changed}{'~' * max(round(0.3 * len(text)), 1)}"


def _of_window(tree: ast.Module) -> Iterator[str]:
    for node in _read(tree, _docstrings(tree)):
        yield from _texts_of(node)
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and _SAID.fullmatch(_name(call.func)):
            yield from (text for text in _constants(call.args) if re.search(r"[A-Za-z]{2}", text))


def _constants(nodes: Iterable[ast.expr]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def _of_core(tree: ast.Module) -> Iterator[str]:
    """Texts of errors and progress, and titles of edits."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and _name(node.func).rpartition(".")[2] in _HEARD:
            for argument in node.args:
                for text in _read(argument, set()):
                    yield from _texts_of(text)
        elif isinstance(node, ast.Call):
            for keyword in node.keywords:
                if keyword.arg in _TITLES:
                    for text in _read(keyword.value, set()):
                        yield from _texts_of(text)
        elif isinstance(node, ast.FunctionDef):
            yield from _defaults(node)


def _defaults(function: ast.FunctionDef) -> Iterator[str]:
    """Titles that an edit has when none is given."""
    spec = function.args
    pairs = list(zip(spec.args[::-1], spec.defaults[::-1], strict=False))
    pairs += [(a, d) for a, d in zip(spec.kwonlyargs, spec.kw_defaults, strict=True) if d]
    for argument, default in pairs:
        if argument.arg in _TITLES:
            yield from _texts_of(default)


def _read(node: ast.AST, silent: set[int]) -> Iterator[ast.expr]:
    """Texts below ``node``, those left out that nobody reads."""
    if id(node) in silent:
        return
    if isinstance(node, ast.Constant | ast.JoinedStr):
        yield node
        return
    if isinstance(node, ast.Call) and _SILENT.fullmatch(_name(node.func)):
        return
    for child in _children(node):
        yield from _read(child, silent)


def _children(node: ast.AST) -> Iterable[ast.AST]:
    if isinstance(node, ast.Dict):
        return node.values
    if isinstance(node, ast.Subscript):  # the key is no text
        return (node.value,)
    if isinstance(node, ast.Compare | ast.Import | ast.ImportFrom | ast.alias):
        return ()
    if isinstance(node, ast.AnnAssign):
        return (node.value,) if node.value is not None else ()
    if isinstance(node, ast.arg):
        return ()
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return (*node.body, node.args)
    return ast.iter_child_nodes(node)


def _docstrings(tree: ast.Module) -> set[int]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            for line in node.body:
                if isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant):
                    found.add(id(line.value))
    return found


def _texts_of(node: ast.expr) -> Iterator[str]:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        template = node.value
    elif isinstance(node, ast.JoinedStr):
        template = _template(node)
    else:
        return
    for part in re.split(r"  ·  |   ", template.partition("##")[0]):
        text = part.strip()
        if _is_text(text):
            yield text


def _template(node: ast.JoinedStr) -> str:
    """An f-string with named fields; an icon at its start is no part of it."""
    names: list[str] = []
    parts = []
    for value in node.values:
        if isinstance(value, ast.Constant):
            parts.append(str(value.value))
        elif isinstance(value, ast.FormattedValue):
            name = _name(value.value)
            if not names and not "".join(parts).strip() and "icon" in name.casefold():
                continue
            short = re.sub(r"\W", "", name.rpartition(".")[2]) or "value"
            while short in names:
                short += "2"
            names.append(short)
            parts.append(f"{{{short}}}")
    return "".join(parts)


def _name(node: ast.AST) -> str:
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        return f"{_name(node.value)}.{node.attr}"
    if isinstance(node, ast.Call):
        return _name(node.args[0]) if _name(node.func) in _PLAIN and node.args else _name(node.func)
    if isinstance(node, ast.Subscript):
        return _name(node.value)
    return "value"


_PLAIN = {"int", "float", "str", "len", "round", "repr"}


def _is_text(text: str) -> bool:
    """Whether a person is meant to read it: words, not a name in the program."""
    fixed = re.sub(r"\{\w+\}", " ", text)
    if text in _PLACES or _SHORTCUT.fullmatch(text) or not re.search(r"[A-Za-z]{2}", fixed):
        return False
    if re.search(r"[\n_=<>|\\*%]|\.\w+$|^[#.$]|^--|::|//", fixed):
        return False
    has_words = re.search(r"[A-Za-z,.:;)…]\s+[(A-Za-z\"]", fixed) is not None
    starts = re.match(r"[A-Z][a-z]", text) is not None
    of_one = bool(re.search(r"\{\w+\} [a-z]{3,}|[a-z]{2,} \{\w+\}", text))
    return starts or has_words or of_one


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        CATALOGUE.parent.mkdir(exist_ok=True)
        CATALOGUE.write_text(content(), encoding="utf-8")
    else:
        sys.stdout.write(content())
