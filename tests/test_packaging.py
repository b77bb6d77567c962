"""What the wheel carries."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import gaga_core

_ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=_ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


def test_the_wheel_holds_both_packages_with_their_assets_and_no_screenshot(wheel: Path) -> None:
    """The types of both packages are for others to check against, too (PEP 561)."""
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    for package, folder in (("gaga_core", _ROOT), ("gaga_studio", _ROOT / "app")):
        sources = (folder / package).rglob("*.py")
        wanted = {path.relative_to(folder).as_posix() for path in sources}
        assert wanted <= names
        assert f"{package}/py.typed" in names
    for kind in ("fonts", "shaders", "web"):
        files = {path.name for path in (_ROOT / "assets" / kind).iterdir()}
        assert files == {Path(name).name for name in names if f"/assets/{kind}/" in name}
    assert not [name for name in names if name.endswith((".png", ".jpg"))]
    assert not [
        name
        for name in names
        if not name.startswith(("gaga_core/", "gaga_studio/", "gaga_studio-"))
    ]


def test_the_version_stands_in_one_place(wheel: Path) -> None:
    assert wheel.name.startswith(f"gaga_studio-{gaga_core.__version__}-")
    text = (_ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert gaga_core.__version__ not in text
