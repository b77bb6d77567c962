"""Reading the documentation's pages: tables by their headings, code by its language."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.glob("*.md"), *DOCS.glob("guide/*.md"), *ROOT.glob("*.md")])


def tables(page: Path) -> dict[str, list[list[str]]]:
    """Rows of all tables of a page by the heading above them, head rows left out."""
    found: dict[str, list[list[str]]] = {}
    heading, rows = "", 0
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("#").strip()
        rows = rows + 1 if line.startswith("|") else 0
        if rows > 2:
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))]
            found.setdefault(heading, []).append(cells)
    return found


def fields(page: Path, heading: str) -> tuple[set[str], set[str]]:
    """Names in the first cells of a heading's tables: those always there, and the optional ones."""
    required: set[str] = set()
    optional: set[str] = set()
    for cells in tables(page)[heading]:
        names = re.findall(r"`([^`]+)`", cells[0])
        (optional if "optional" in " ".join(cells[1:]) else required).update(names)
    return required, optional


def code_blocks(page: Path, language: str) -> list[str]:
    """The contents of a page's code blocks of this language."""
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)
