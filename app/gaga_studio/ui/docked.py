"""The dockable panels: their titles, who draws them, and where each is docked."""

from gaga_studio.features.find.memory_bank import timeline_of
from gaga_studio.session.session import Session
from gaga_studio.system.layout import Panel
from gaga_studio.ui.panels import (
    bank_timeline,
    bookmarks,
    camera_path,
    film_strip,
    history,
    inspector,
    memory_bank,
    objects,
    selecting,
)
from gaga_studio.ui.state import UiState
from gaga_studio.ui.viewport.viewport import ViewportPanel

_MAIN = "MainDockSpace"


def panels(session: Session, ui: UiState, picture: ViewportPanel) -> tuple[Panel, ...]:
    """Every panel of the window. State of a scene is looked up when a panel is drawn."""

    def draw_objects() -> None:
        objects.draw(session, ui.scene.objects, ui.scene.picture.evidence.menu, ui.area)

    def draw_timeline() -> None:
        bank_timeline.draw(session)

    return (
        Panel(
            "Viewport",
            lambda: picture.draw(session, ui.scene.picture, ui.area),
            _MAIN,
            _MAIN,
            is_bare=True,
        ),
        Panel("Objects", draw_objects, "Left", "Right"),
        Panel(
            "Inspector",
            lambda: inspector.draw(session, ui.scene.inspector),
            "Right",
            "RightBottom",
        ),
        Panel(
            "Select by",
            lambda: selecting.draw(session, ui.scene.select_by),
            "Right",
            "RightBottom",
        ),
        Panel(
            "Memory bank",
            lambda: memory_bank.draw(session, ui.scene.picture.evidence),
            "RightDown",
            "RightBottom",
        ),
        Panel("Views", lambda: film_strip.draw(session, ui.scene.film_strip), "Bottom", "Right"),
        Panel("Camera path", lambda: camera_path.draw(session), "Bottom", "Right"),
        Panel("Bookmarks", lambda: bookmarks.draw(session, ui.scene.bookmarks), "Bottom", "Right"),
        Panel(
            bank_timeline.TITLE,
            draw_timeline,
            "Bottom",
            "Right",
            is_wanted=lambda: timeline_of(session).is_open,
        ),
        Panel(
            "History",
            lambda: history.draw(session, ui.scene.history),
            "RightDown",
            "RightBottom",
        ),
    )
