"""The smallest box around the selection, as lines in the picture."""

from imgui_bundle import ImVec2, imgui

from gaga_core.camera import Camera
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import theme
from gaga_studio.ui.viewport import ground_overlay

_NEAREST = 1e-6  # depth from which a corner is in front of the camera, scene units
_EDGES = [(i, i | 1 << side) for side in range(3) for i in range(8) if not i >> side & 1]


def draw(session: Session, camera: Camera, corner: ImVec2) -> None:
    """The box where *Box* is on and something is selected; not during a drag."""
    document = session.document
    if document is None or not session.view.show_box or session.is_previewing:
        return
    box = document.selected_oriented_box()
    if box is None:
        return
    corners = box.corners()
    if (camera.project(corners)[1] < _NEAREST).any():
        return  # behind the camera: a line there would go astray
    places = ground_overlay.on_screen(corners, camera, corner)
    drawing = imgui.get_window_draw_list()
    for one, two in _EDGES:
        drawing.add_line(places[one], places[two], theme.u32(theme.BACK, 0.7), theme.scaled(3))
        drawing.add_line(places[one], places[two], theme.u32(theme.ACCENT, 0.95), theme.scaled(1.4))
