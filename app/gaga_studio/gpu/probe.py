"""``python -m gaga_studio.gpu.probe``: what the OpenGL driver is, as `gaga doctor` asks.

Each line that it prints is JSON with ``ok`` and ``text``, and the last one counts: the first says
what it means when a broken driver ends the process.
"""

import json
import sys

import moderngl

_NONE = "no OpenGL 3.3 context: install a graphics driver (on Debian: libgl1 libegl1)"


def main() -> int:
    """Open a context without a window (EGL on Linux) and print what it is; status 1 without."""
    _tell(False, _NONE)
    backend: dict[str, str] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        context = moderngl.create_context(require=330, standalone=True, **backend)  # type: ignore[arg-type]
    except (moderngl.Error, OSError, ValueError, RuntimeError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    info = context.info
    _tell(True, f"{info['GL_VERSION']} · {info['GL_RENDERER']}")
    context.release()
    return 0


def _tell(ok: bool, text: str) -> None:
    sys.stdout.write(json.dumps({"ok": ok, "text": text}) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
