"""Whether there is something to save: which states of the history hold the same content."""

from gaga_core.scene.history import History


class Changes:
    """Maps states of a history to contents; selecting makes a state but no new content."""

    def __init__(self) -> None:
        self._content = {0: 0}  # by History.state_id
        self._newest = 0
        self._saved = 0

    def note(self, before: int, after: int, is_content: bool) -> None:
        """State ``after`` was made from ``before`` by an edit."""
        if before == after:
            return
        self._newest += is_content
        self._content[after] = self._newest if is_content else self.content(before)

    def content(self, state: int) -> int:
        """The content that a state holds."""
        return self._content.get(state, 0)

    def saved(self, content: int) -> None:
        """``content`` is on disk now."""
        self._saved = content

    def is_unsaved(self, history: History) -> bool:
        """Whether the present state differs from what is on disk."""
        return self.content(history.state_id) != self._saved
