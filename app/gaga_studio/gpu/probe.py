"""``python -m gaga_studio.gpu.probe``: one JSON line about the OpenGL driver; status 1 without.

Run in a process of its own by ``gaga doctor``: a broken driver may crash.
"""

import json
import sys

import moderngl


def main() -> int:
    """Open a context without a window (EGL on Linux) and print what it is."""
    backend: dict[str, str] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        context = moderngl.create_context(require=330, standalone=True, **backend)  # type: ignore[arg-type]
    except (moderngl.Error, OSError, ValueError, RuntimeError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    info = context.info
    answer = {"version": info["GL_VERSION"], "renderer": info["GL_RENDERER"]}
    sys.stdout.write(json.dumps(answer) + "\n")
    context.release()
    return 0


if __name__ == "__main__":
    sys.exit(main())
