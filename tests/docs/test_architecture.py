"""docs/architecture.md names files and packages that exist, and leaves none out."""

import re

import gaga_core
from tests.docs.pages import DOCS, ROOT, tables

_PAGE = DOCS / "architecture.md"


def _text() -> str:
    return _PAGE.read_text(encoding="utf-8")


def test_every_named_file_exists() -> None:
    named = set(re.findall(r"`((?:gaga_core|app)/[\w/]+\.py)`", _text()))
    assert len(named) > 30
    assert not [name for name in named if not (ROOT / name).is_file()]


def test_twenty_changes_have_a_file_each() -> None:
    rows = tables(_PAGE)["Which file for which change"]
    files = [re.findall(r"`([\w/]+\.py)`", cells[1]) for cells in rows]
    assert len(rows) >= 20
    assert all(len(found) == 1 for found in files)
    assert len({found[0] for found in files}) == len(rows), "each row is another file"


def test_every_package_is_listed() -> None:
    core = {p.parent.name for p in (ROOT / "gaga_core").glob("*/__init__.py")}
    window = {p.parent.name for p in (ROOT / "app" / "gaga_studio").glob("*/__init__.py")}
    for packages, heading in (
        (core, "The packages of the core"),
        (window, "The packages of the window"),
    ):
        listed = " ".join(cells[0] for cells in tables(_PAGE)[heading])
        assert packages == set(re.findall(r"`(\w+)/`", listed))


def test_every_file_that_any_page_names_exists() -> None:
    pages = [*DOCS.glob("*.md"), *DOCS.glob("guide/*.md"), *ROOT.glob("*.md")]
    pattern = r"`((?:gaga_core|app|tests|docs)/[\w/.]+\.(?:py|json|md|cff))`"
    for page in pages:
        named = set(re.findall(pattern, page.read_text(encoding="utf-8")))
        missing = [name for name in named if not (ROOT / name).is_file()]
        assert not missing, f"{page.name} names {missing}"


def test_the_citation_is_of_this_version() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", text, re.M) == [gaga_core.__version__]
    assert {"cff-version", "message", "title", "authors"} <= set(
        re.findall(r"^([\w-]+):", text, re.M)
    )
