"""What a user can correct becomes a notice; what is a defect does not."""

import pytest

from gaga_core.errors import GagaError
from gaga_studio.session.notices import Level, NothingSelectedError, notifies


class _Told:
    def __init__(self) -> None:
        self.notices: list[tuple[Level, str]] = []

    def notify(self, level: Level, text: str, command: str = "") -> None:
        self.notices.append((level, text))


@notifies
def _act(told: _Told, result: object) -> object:
    if isinstance(result, Exception):
        raise result
    return result


@pytest.mark.parametrize(("result", "did"), [(True, True), (False, False), (None, False)])
def test_a_result_says_whether_something_was_done(result: object, did: bool) -> None:
    told = _Told()
    assert _act(told, result) is did
    assert told.notices == []


def test_the_type_of_the_error_sets_the_level() -> None:
    """The same words are an error unless the type says that nothing is selected."""
    told = _Told()
    hint = NothingSelectedError()
    assert not _act(told, hint)
    assert not _act(told, GagaError(str(hint)))
    assert told.notices == [(Level.HINT, str(hint)), (Level.ERROR, str(hint))]


def test_defects_pass() -> None:
    told = _Told()
    with pytest.raises(ZeroDivisionError):
        _act(told, ZeroDivisionError())
    assert told.notices == []


def test_the_action_keeps_its_name() -> None:
    assert _act.__name__ == "_act"
