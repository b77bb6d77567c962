"""Which dialog answers which request of the session."""

from collections.abc import Callable

from imgui_bundle import imgui

from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session

Opener = Callable[[Session], object]


class RequestTable:
    """One opener for each request; every dialog registers its own."""

    def __init__(self) -> None:
        self._openers: dict[Request, Opener] = {}

    @property
    def requests(self) -> frozenset[Request]:
        """The requests that are answered."""
        return frozenset(self._openers)

    def register(self, request: Request, opener: Opener) -> None:
        """Let ``opener`` answer ``request``; ``ValueError`` when another one does already."""
        if request in self._openers:
            raise ValueError(f"{request}: two dialogs answer it")
        self._openers[request] = opener

    def register_popup(self, request: Request, name: str) -> None:
        """Let ``request`` open the popup of this name."""
        self.register(request, lambda _: imgui.open_popup(name))

    def take(self, session: Session) -> None:
        """Answer what the session asks for, if anything."""
        request = session.take_request()
        if request is not None:
            self._openers[request](session)
