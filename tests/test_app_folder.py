"""The folder of ``make app`` in a bare Debian: no Python, the libraries of a desktop, nothing else.

Takes minutes, root, debootstrap and Xvfb: ``make test-app``, or GAGA_TEST_APP=dist/gaga-studio. A
root that is there already is used: GAGA_TEST_ROOT.
"""

import os
import shlex
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageGrab

from gaga_core.io.splats.splat_files import write_splats
from tests.display import xvfb
from tests.scenes import random_gaussians

_LIBRARIES = (
    "libgl1,libegl1,libgl1-mesa-dri,libx11-6,libxrandr2,libxinerama1,libxcursor1,libxi6,"
    "libxkbcommon0,libxext6,libxrender1"
)
_PLACE = "opt/gaga-studio"  # in the root
_SECONDS = 600.0  # until the demo is drawn: kernels are compiled and the demo is copied first
_DRAWN = 25.0  # standard deviation of the picture's middle: an empty window has less than 10

pytestmark = pytest.mark.skipif(
    "GAGA_TEST_APP" not in os.environ, reason="minutes, and root: make test-app"
)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A Debian root with the program in /opt, and no home of anybody."""
    if os.geteuid() != 0 or shutil.which("debootstrap") is None:
        pytest.skip("needs root and debootstrap (apt-get install debootstrap)")
    named = os.environ.get("GAGA_TEST_ROOT")
    made = Path(named) if named else tmp_path_factory.mktemp("debian") / "root"
    if not (made / "etc" / "debian_version").is_file():
        command = ["debootstrap", "--variant=minbase", f"--include={_LIBRARIES}", "bookworm"]
        subprocess.run([*command, str(made)], check=True, capture_output=True)
    place = made / _PLACE
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(Path(os.environ["GAGA_TEST_APP"]).resolve(), place, symlinks=True)
    home = made / "root"
    shutil.rmtree(home)
    home.mkdir()
    yield made
    if not named:
        shutil.rmtree(made)


def _inside(root: Path, command: str) -> list[str]:
    """What runs ``command`` in ``root`` with /proc and /dev, in a mount namespace of its own."""
    place = shlex.quote(str(root))
    mounts = f"mount -t proc proc {place}/proc && mount --bind /dev {place}/dev"
    environment = f"HOME=/root PATH=/usr/bin:/bin:/usr/sbin DISPLAY={os.environ.get('DISPLAY', '')}"
    start = f"exec env -i {environment} /usr/sbin/chroot {place} {command}"
    return ["unshare", "-m", "sh", "-c", f"{mounts} && {start}"]


def _run(root: Path, command: str) -> str:
    done = subprocess.run(
        _inside(root, command), capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_the_command_works_without_python_and_torch(root: Path) -> None:
    """Files of splats, a COLMAP model (a child process), a picture (compiled kernels)."""
    program = f"/{_PLACE}/gaga"
    assert subprocess.run(_inside(root, "/bin/sh -c 'command -v python3'"), check=False).returncode
    write_splats(root / "root" / "a.ply", random_gaussians(500))
    assert "500" in _run(root, f"{program} info /root/a.ply")
    _run(root, f"{program} export /root/a.ply --out /root/a.sog")
    assert (root / "root" / "a.sog").stat().st_size > 1000
    _run(root, f"{program} export /root/a.ply --out /root/a.html --decimate 0.5")
    report = _run(root, f"{program} doctor")
    assert "torch         not installed" in report
    assert "PROBLEM" not in report


def test_the_window_shows_the_demo(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with xvfb((1280, 800)) as display:
        start = time.monotonic()
        program = subprocess.Popen(_inside(root, f"/{_PLACE}/gaga-studio --demo"))
        try:
            spread, picture = 0.0, Image.new("RGB", (1, 1))
            while spread < _DRAWN and time.monotonic() - start < _SECONDS:
                assert program.poll() is None, "the program ended"
                time.sleep(1)
                picture = ImageGrab.grab(xdisplay=display)
                spread = float(np.std(np.asarray(picture)[200:500, 400:800].astype(float)))
            seconds = time.monotonic() - start
            time.sleep(5)
            assert program.poll() is None
        finally:
            program.terminate()
            program.wait(timeout=30)
    kept = Path("build") / "app-in-debian.png"
    kept.parent.mkdir(exist_ok=True)
    picture.save(kept)
    assert spread >= _DRAWN
    with capsys.disabled():
        print(f"\nfirst picture of the demo after {seconds:.0f} s; {kept}")  # noqa: T201
