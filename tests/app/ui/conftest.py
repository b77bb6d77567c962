"""A Dear ImGui without a window."""

from collections.abc import Iterator

import pytest
from imgui_bundle import ImVec2, imgui


@pytest.fixture
def context() -> Iterator[None]:
    """A Dear ImGui of its own, without a window."""
    before, own = imgui.get_current_context(), imgui.create_context()
    imgui.set_current_context(own)
    io = imgui.get_io()
    io.display_size = ImVec2(100, 100)
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
    io.set_ini_filename("")
    yield
    imgui.destroy_context(own)
    if before is not None:
        imgui.set_current_context(before)
