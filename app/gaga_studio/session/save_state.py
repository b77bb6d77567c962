"""Whether there is something to save: which states of the history hold the same content."""

from collections.abc import Sequence

from gaga_core.scene.edits.history import History

Content = tuple[int, int]


class SaveState:
    """Maps states of a history to contents; selecting makes a state but no new content."""

    def __init__(self) -> None:
        self._content = {0: 0}  # by History.state_id
        self._newest = 0
        self._outside = 0  # changes of what is saved but is no edit of the scene
        self._saved: Content | None = (0, 0)

    def note(self, before: int, after: int, is_content: bool) -> None:
        """Note that an edit made state ``after`` from ``before``."""
        if before == after:
            return
        self._newest += is_content
        self._content[after] = self._newest if is_content else self._content.get(before, 0)

    def note_outside_history(self) -> None:
        """Note a change that a save keeps and undo does not know: bookmarks, the path."""
        self._outside += 1

    def content(self, state: int) -> Content:
        """Return the content of a state, and the count of changes outside the history."""
        return self._content.get(state, 0), self._outside

    def resume(self, contents: Sequence[int]) -> None:
        """Take ``contents`` as those of the states 0, 1, 2 and so on."""
        self._content = dict(enumerate(contents))
        self._newest = max(contents)

    def saved(self, content: Content | None) -> None:
        """Note that ``content`` is on disk now; None: nothing is."""
        self._saved = content

    def is_unsaved(self, history: History) -> bool:
        """Whether the present state differs from what is on disk."""
        return self.content(history.state_id) != self._saved
