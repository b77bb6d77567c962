"""The status line: what a click does now, and what is under the mouse."""

from gaga_studio.session import Session
from gaga_studio.tools.base import Tool


def status_text(session: Session, tool: Tool) -> str:
    """One line, never empty."""
    document = session.document
    if document is None:
        return "Open a scene folder or a .ply file, or drop one here."
    if session.rig.is_flying:
        return "W A S D fly, Q down, E up, Shift fast, Alt slow; drag looks around. V ends flying."
    if document.cleaning is not None:
        return "Enter applies the cleaning, Esc leaves everything as it is. Drag orbits."
    if session.hint:
        return session.hint
    hint = tool.hint(session)
    hovered = session.hovered_group
    return f"{document.name_of(hovered)}  ·  {hint}" if hovered else hint
