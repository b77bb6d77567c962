"""Sphinx settings: MyST pages, the furo theme, and API pages from the docstrings of the core."""

import importlib
import importlib.metadata
import inspect
import pkgutil
import re
import sys
from pathlib import Path
from typing import Any

_DOCS = Path(__file__).parent
sys.path.insert(0, str(_DOCS.parent))

import gaga_core  # noqa: E402  the checkout that holds this page, not an installed one

project = "gaga-studio"
author = "The gaga-studio authors"
project_copyright = author
release = importlib.metadata.version("gaga-studio")
version = release

# The public interface and the document behind it are both called Scene.
suppress_warnings = ["ref.python"]
extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "gaga-studio"
html_show_sphinx = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
add_module_names = False

# `code` in a docstring is code; everything else of it is plain text, never markup.
_CODE = re.compile(r"(`+)(.+?)\1", re.S)
_MARKUP = re.compile(r"([\\*_|`])")
_BULLET = re.compile(r"\s*[-*] (?=\S)")


def _escaped(text: str) -> str:
    """Return plain text as reStructuredText, its `code` kept as code."""
    out, last = [], 0
    for code in _CODE.finditer(text):
        plain = _MARKUP.sub(r"\\\1", text[last : code.start()])
        out += [plain, f"``{code.group(2).strip()}``\\ "]
        last = code.end()
    return "".join([*out, _MARKUP.sub(r"\\\1", text[last:])])


def _blocks(lines: list[str]) -> list[tuple[str, str]]:
    """Return the parts of a docstring: ("text" | "item" | "line", content).

    An indented line that continues no item stands as it is, a line of its own.
    """
    found: list[tuple[str, str]] = []
    before = ""
    for line in lines:
        bullet = _BULLET.match(line)
        if not line.strip():
            before = ""
            continue
        if bullet:
            kind, text = "item", line[bullet.end() :]
        elif line.startswith(" ") and before != "item":
            kind, text = "line", line.strip()
        else:
            kind, text = "item" if line.startswith(" ") else "text", line.strip()
        if not bullet and kind == before and kind != "line":
            found[-1] = (kind, f"{found[-1][1]} {text}")
        else:
            found.append((kind, text))
        before = kind
    return found


def _plain_docstring(
    _app: object, _what: str, _name: str, _obj: object, _options: object, lines: list[str]
) -> None:
    """Make reStructuredText of a plain docstring, so that no docstring can break the build."""
    marks = {"text": "", "item": "- ", "line": "| "}
    out: list[str] = []
    before = "text"
    for kind, text in _blocks(lines):
        if out and (kind == "text" or kind != before):
            out.append("")
        out.append(marks[kind] + _escaped(text))
        before = kind
    lines[:] = [*out, ""]


def _skip_foreign(
    _app: object, _what: str, _name: str, obj: object, skip: bool, _options: object
) -> bool | None:
    """Leave out what a module imports from elsewhere under a disguise (scipy's decorators)."""
    module = getattr(inspect.unwrap(obj), "__module__", None) if callable(obj) else None
    foreign = isinstance(module, str) and not module.startswith("gaga_core")
    return True if skip or foreign else None


def _modules(package: str) -> list[str]:
    """Return the public modules of a package in the core, itself first, kernels left out."""
    root = importlib.import_module(package)
    if not hasattr(root, "__path__"):
        return [package]
    found = [m.name for m in pkgutil.walk_packages(root.__path__, f"{package}.")]
    return [package, *(n for n in found if "_kernels" not in n and "._" not in n)]


def _write_api_pages(_app: object) -> None:
    """Write one page for each package of the core into docs/api, which git ignores."""
    folder = _DOCS / "api"
    folder.mkdir(exist_ok=True)
    packages = [m for m in pkgutil.iter_modules(gaga_core.__path__) if m.name != "cli"]
    names = [m.name for m in packages if m.ispkg] + ["nouns"]
    nouns = [f"gaga_core.{m.name}" for m in packages if not m.ispkg]
    for name in names:
        modules = nouns if name == "nouns" else _modules(f"gaga_core.{name}")
        title = "The nouns" if name == "nouns" else f"gaga_core.{name}"
        page = [title, "=" * len(title), ""]
        for module in modules:
            if module != f"gaga_core.{name}":
                page += [module, "-" * len(module), ""]
            page += [f".. automodule:: {module}", "   :members:", "   :ignore-module-all:", ""]
        text = "\n".join(page)
        file = folder / f"{name}.rst"
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
    for old in folder.glob("*.rst"):
        if old.stem not in names:
            old.unlink()


def setup(app: Any) -> None:
    """Connect the steps above to Sphinx."""
    app.connect("builder-inited", _write_api_pages)
    app.connect("autodoc-skip-member", _skip_foreign)
    app.connect("autodoc-process-docstring", _plain_docstring)
