"""Files, pages and figures that the documentation names are there."""

import re
from pathlib import Path

import pytest

import gaga_core
from tests.bench.figures import Figure
from tests.bench.record import PATH, read_record
from tests.bench.tables import PAGE, other_bars, with_tables
from tests.docs.pages import DOCS, PAGES, ROOT, tables


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_file_that_a_page_names_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`((?:gaga_core|app|tests|docs)/[\w/.]+)`", text)
    linked = re.findall(r"\]\(([^)#:]+)[)#]", text)
    assert [name for name in named if not (ROOT / name).exists()] == []
    assert [name for name in linked if not (page.parent / name).exists()] == []


def test_every_package_is_listed() -> None:
    for root, heading in (
        (ROOT / "gaga_core", "The packages of the core"),
        (ROOT / "app" / "gaga_studio", "The packages of the window"),
    ):
        listed = " ".join(cells[0] for cells in tables(DOCS / "architecture.md")[heading])
        packages = {path.parent.name for path in root.glob("*/__init__.py")}
        assert packages == set(re.findall(r"`(\w+)/`", listed))


def test_every_page_of_the_guide_is_in_the_contents() -> None:
    listed = re.findall(r"^guide/(\w+)$", (DOCS / "index.md").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == sorted(page.stem for page in DOCS.glob("guide/*.md"))


def test_the_citation_is_of_this_version() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", text, re.M) == [gaga_core.__version__]


def test_the_page_of_figures_is_made_from_the_record() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert with_tables(page, read_record(PATH)) == page, "python -m tests.bench --tables"
    with pytest.raises(ValueError, match="Speed"):
        with_tables(page.replace("## Speed", "## Speeds"), read_record(PATH))


def test_the_scores_of_the_readme_are_on_the_page_of_figures() -> None:
    def scores(page: Path) -> set[tuple[float, ...]]:
        found = re.findall(r"([\d.]+) / ([\d.]+) / ([\d.]+)", page.read_text(encoding="utf-8"))
        return {tuple(map(float, one)) for one in found}

    assert scores(ROOT / "README.md") <= scores(PAGE)


def test_a_benchmark_with_another_bar_than_the_page_is_named() -> None:
    name = "delete 500k of 1M", "4M: click, CPU of all threads"
    assert other_bars([Figure(n, 1.0, "", "<= 50") for n in name]) == []
    assert other_bars([Figure(n, 1.0, "", "<= 60") for n in name]) == [name[1]]
