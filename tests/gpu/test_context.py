"""The context of a window that GLFW made is found; shaders are whole files of the project."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gaga_core.errors import GagaError
from gaga_studio.gpu.context import attach, is_software, load_program, set_uniforms

_WINDOW = """
import glfw
from gaga_studio.gpu.context import attach
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import ViewState
from gaga_core.scene.scene import Scene
from tests.scenes import objects_scene
assert glfw.init()
for hint, value in ((glfw.VISIBLE, 0), (glfw.CONTEXT_VERSION_MAJOR, 3),
                    (glfw.CONTEXT_VERSION_MINOR, 3), (glfw.OPENGL_FORWARD_COMPAT, 1),
                    (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)):
    glfw.window_hint(hint, value)
window = glfw.create_window(64, 64, "", None, None)
glfw.make_context_current(window)
ctx = attach()
viewport = Viewport(ctx)
synthetic = objects_scene(2, 50)
camera = synthetic.cameras[0]
viewport.draw(Scene.of(synthetic.gaussians), camera, ViewState(), wait=True)
assert viewport.read_pixels().std() > 5
viewport.release()
assert ctx.error == "GL_NO_ERROR"
glfw.terminate()
"""


@pytest.mark.window
def test_attach_to_a_window(display: str) -> None:
    run = subprocess.run(
        [sys.executable, "-c", _WINDOW],
        env={**os.environ, "DISPLAY": display},
        cwd=Path(__file__).resolve().parents[2],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert run.returncode == 0, run.stderr


def test_without_any_context_there_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    import glfw
    import moderngl

    def refuse(**_: Any) -> None:
        raise moderngl.Error("cannot detect OpenGL context")

    monkeypatch.setattr(glfw, "get_current_context", lambda: None)
    monkeypatch.setattr(moderngl, "create_context", refuse)
    with pytest.raises(GagaError, match=r"no OpenGL 3\.3"):
        attach()


@pytest.mark.gl
def test_drawing_on_the_processor_is_recognised(gl: Any) -> None:
    renderer = gl.info["GL_RENDERER"].lower()
    assert is_software(gl) == ("llvmpipe" in renderer or "softpipe" in renderer)


@pytest.mark.gl
def test_uniforms_that_a_variant_lacks_are_passed_over(gl: Any) -> None:
    program = load_program(gl, "lines.vert", "lines.frag")
    set_uniforms(program, {"u_size": (3.0, 4.0), "u_absent": 1})
    member: Any = program["u_size"]
    assert member.value == (3.0, 4.0)
    program.release()
