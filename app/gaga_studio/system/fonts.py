"""Fonts of the system for letters that our own font lacks: Arabic, Chinese, Hebrew, emoji."""

import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

_PATIENCE_S = 5.0  # for fontconfig, which may read its cache again
# Where there is no fontconfig: files that come with the systems, wide coverage first.
_SHIPPED = {
    "darwin": (
        "/System/Library/Fonts/PingFang.ttc",
        "/System/Library/Fonts/Hiragino Sans GB.ttc",
        "/System/Library/Fonts/AppleSDGothicNeo.ttc",
        "/System/Library/Fonts/GeezaPro.ttc",
        "/System/Library/Fonts/ArialHB.ttc",
        "/System/Library/Fonts/Supplemental/Arial Unicode.ttf",
    ),
    "win32": (
        "C:/Windows/Fonts/msyh.ttc",
        "C:/Windows/Fonts/YuGothR.ttc",
        "C:/Windows/Fonts/malgun.ttf",
        "C:/Windows/Fonts/segoeui.ttf",
        "C:/Windows/Fonts/seguisym.ttf",
        "C:/Windows/Fonts/seguiemj.ttf",
        "C:/Windows/Fonts/Nirmala.ttf",
    ),
}
_PREFERRED = ("NotoSans", "NotoSansCJK", "DejaVuSans.ttf", "Noto")  # beginnings of file names
_FORMS = (".ttf", ".otf", ".ttc")


def fonts_with(letter: str) -> tuple[Path, ...]:
    """Font files that have ``letter``, sans serif and upright first; () where none is known.

    Without fontconfig the files that the system ships: they may lack it.
    """
    program = shutil.which("fc-list")
    if program is None:
        return tuple(path for path in map(Path, _SHIPPED.get(sys.platform, ())) if path.is_file())
    try:
        found = subprocess.run(
            [program, f":charset={ord(letter):x}", "file"],
            capture_output=True,
            text=True,
            timeout=_PATIENCE_S,
            check=False,
        ).stdout
    except (OSError, subprocess.TimeoutExpired):
        return ()
    paths = (Path(line.strip().rstrip(":")) for line in found.splitlines())
    return tuple(sorted((p for p in paths if p.suffix.lower() in _FORMS), key=_rank))


def _rank(path: Path) -> tuple[int, bool, str]:
    family = next((i for i, name in enumerate(_PREFERRED) if path.name.startswith(name)), 99)
    is_plain = "regular" in path.stem.lower() or "-" not in path.stem
    return family, not is_plain, path.name


def foreign_letters(texts: Iterable[str]) -> set[str]:
    """Letters of ``texts`` beyond Latin, Greek, Cyrillic and common marks."""
    return {
        letter for text in texts if not text.isascii() for letter in text if ord(letter) > 0x52F
    }
