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
    shipped = {name.partition("/assets/")[2] for name in names if "/assets/" in name}
    assert shipped == {"objects.npz"} | {
        path.relative_to(_ROOT / "assets").as_posix()
        for kind in ("demo", "fonts", "shaders", "web")
        for path in (_ROOT / "assets" / kind).rglob("*")
        if path.is_file()
    }
    pictures = (name for name in names if name.endswith((".png", ".jpg")))
    assert all(name.startswith("gaga_core/assets/demo/") for name in pictures)
    assert not [
        name
        for name in names
        if not name.startswith(("gaga_core/", "gaga_studio/", "gaga_studio-"))
    ]


def test_the_demo_comes_out_of_the_wheel_without_what_draws_it(wheel: Path, tmp_path: Path) -> None:
    """A checkout has more on its path: the wheel's folder comes first, and nothing else is used."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "wheel")
    code = f"""
import sys
sys.path.insert(0, {str(tmp_path / "wheel")!r})
from gaga_core.cli.main import main
assert main(["demo", {str(tmp_path / "scene")!r}]) == 0
ours = [m.__file__ for n, m in sys.modules.items() if n.startswith(("gaga_core", "tools"))]
assert all(file.startswith({str(tmp_path / "wheel")!r}) for file in ours), ours
"""
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True)
    assert (tmp_path / "scene" / "point_cloud.ply").is_file()
    assert len(list((tmp_path / "scene" / "images").iterdir())) == 40


def test_the_version_stands_in_one_place(wheel: Path) -> None:
    assert wheel.name.startswith(f"gaga_studio-{gaga_core.__version__}-")
    text = (_ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert gaga_core.__version__ not in text
