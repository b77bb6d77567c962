"""Every page of the guide shows the window, and says what to do when something goes wrong."""

import re
from pathlib import Path

import pytest

from tests.docs.pages import DOCS

_PAGES = sorted(DOCS.glob("guide/*.md"))


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.stem)
def test_a_page_has_a_picture_of_the_window(page: Path) -> None:
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    assert pictures
    assert not [name for name in pictures if not (page.parent / name).is_file()]


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.stem)
def test_a_page_says_what_to_do_when_it_goes_wrong(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert page.stem == "troubleshooting" or "## When it goes wrong" in text


def test_every_page_of_the_guide_is_in_the_contents() -> None:
    listed = re.findall(r"^guide/(\w+)$", (DOCS / "index.md").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == [page.stem for page in _PAGES]


def test_every_test_that_the_page_on_reliability_names_exists() -> None:
    page = (DOCS / "reliability.md").read_text(encoding="utf-8")
    paths = set(re.findall(r"`(tests/[\w/.]+)`", page))
    root = DOCS.parent
    assert [path for path in sorted(paths) if not (root / path).exists()] == []
    files = [root / path for path in paths if path.endswith(".py")]
    texts = "".join(file.read_text(encoding="utf-8") for file in files)
    named = set(re.findall(r"`(test_\w+)`", page))
    assert len(named) > 10
    assert {name for name in named if f"def {name}(" not in texts} == set()
