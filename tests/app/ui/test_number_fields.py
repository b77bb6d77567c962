"""Numbers that are typed: with a unit, with a decimal comma, and what is no number."""

from collections.abc import Iterator
from functools import partial

import pytest
from imgui_bundle import ImVec2, imgui

from gaga_studio.ui.kit import number_fields
from gaga_studio.ui.kit.number_fields import drag, drag_point, typed_number

pytestmark = pytest.mark.usefixtures("context")
_METRES = "%.3f m"


class _Field:
    """A field in a window, and the keyboard and mouse that it is typed into with."""

    def __init__(self, form: str, value: float = 0.5, limits: number_fields.Limits | None = None):
        self.value, self.reports = value, 0
        self._draw = partial(drag, "##Field", speed=0.1, form=form, limits=limits)
        imgui.get_io().config_drag_click_to_input_text = True
        imgui.get_io().config_input_trickle_event_queue = False
        self.frame()
        self.frame()

    def frame(self, *, is_drawn: bool = True) -> None:
        imgui.new_frame()
        if is_drawn:
            self._window()
        imgui.end_frame()

    def _window(self) -> None:
        imgui.set_next_window_pos(ImVec2(0, 0))
        imgui.begin("Window")
        changed, value = self._draw(value=self.value)
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        self._middle = (low.x + high.x) / 2, (low.y + high.y) / 2
        if changed:
            self.value, self.reports = value, self.reports + 1
            assert imgui.is_item_deactivated_after_edit(), "callers keep the edit then"
        drag("##Another", 0.0, 0.1, "%.1f")
        high = imgui.get_item_rect_max()
        self._other = high.x - 3, high.y - 3
        imgui.end()

    def _click(self, place: tuple[float, float]) -> None:
        io = imgui.get_io()
        for is_down in (None, True, False):
            io.add_mouse_pos_event(*place)
            if is_down is not None:
                io.add_mouse_button_event(0, is_down)
            self.frame()

    def begin(self) -> None:
        """Click the field, as to type into it."""
        self._click(self._middle)
        self.frame()

    def type_at_once(self, text: str) -> None:
        """Type and press Enter within one slow frame."""
        self.begin()
        imgui.get_io().add_input_characters_utf8(text)
        imgui.get_io().add_key_event(imgui.Key.enter, True)
        self.frame()

    def type(self, text: str, key: imgui.Key = imgui.Key.enter) -> None:
        """Click the field, type, and end with a key, or by a click on another item (no key)."""
        io = imgui.get_io()
        self.begin()
        for letter in text:
            io.add_input_character(ord(letter))
            self.frame()
        if key is imgui.Key.none:
            self._click(self._other)
        else:
            for is_down in (True, False):
                io.add_key_event(key, is_down)
                self.frame()
        self.frame()


@pytest.fixture(autouse=True)
def _nothing_said() -> Iterator[None]:
    number_fields.take_not_read()
    yield
    assert number_fields.take_not_read() == ""


@pytest.mark.parametrize("key", [imgui.Key.enter, imgui.Key.tab, imgui.Key.none])
@pytest.mark.parametrize(
    ("before", "typed", "metres"),
    [
        (0.5, "2", 2.0),
        (0.5, "10 cm", 0.1),
        (0.5, "1,5", 1.5),
        (0.5, "-12 in", -0.3048),
        (0.5, "0.5 m", 0.5),
        # The digits of what is shown: to Dear ImGui the number stays the same.
        (2.0, "2 cm", 0.02),
        (10.0, "10 cm", 0.1),
        (12.0, "12 in", 0.3048),
        (1.0, "1 ft", 0.3048),
    ],
)
def test_a_length_is_typed_with_its_unit(
    before: float, typed: str, metres: float, key: imgui.Key
) -> None:
    field = _Field(_METRES, before)
    field.type(typed, key)
    assert field.value == pytest.approx(metres)
    assert field.reports == (metres != before), "once, and not while it is typed"


def test_a_length_that_is_typed_within_one_frame_is_kept() -> None:
    field = _Field(_METRES, 10.0)
    field.type_at_once("10 cm")
    assert field.value == pytest.approx(0.1)
    assert field.reports == 1


@pytest.mark.parametrize("typed", ["about 2", "2 parsecs", "1 2", "-"])
def test_what_is_no_number_changes_nothing_and_is_told(typed: str) -> None:
    field = _Field(_METRES)
    field.type(typed)
    assert field.value == 0.5
    assert number_fields.take_not_read().startswith(f'"{typed}" cannot be read here')


@pytest.mark.parametrize("n_frames", [1, 5])
def test_what_is_typed_goes_with_the_field(n_frames: int) -> None:
    """A field that is drawn again is of another object, as after a selection that went."""
    field = _Field(_METRES)
    field.begin()
    imgui.get_io().add_input_characters_utf8("7 cm")
    field.frame()
    for _ in range(n_frames):
        field.frame(is_drawn=False)
    field.value = 2.0
    field.frame()
    field.frame()
    assert (field.value, field.reports) == (2.0, 0)
    field.type("3 cm")
    assert (field.value, field.reports) == (0.03, 1)


def test_escape_and_what_stood_there_change_nothing() -> None:
    field = _Field(_METRES, value=0.50043)
    field.type("7", imgui.Key.escape)
    field.type("0.500")
    assert (field.value, field.reports) == (0.50043, 0)


def test_a_length_without_a_scale_says_what_it_needs() -> None:
    field = _Field("%.3f", value=1.0)
    field.type("12 cm")
    assert field.value == 1.0
    assert "Set scale" in number_fields.take_not_read()
    field.type("twelve")
    assert number_fields.take_not_read() == '"twelve" cannot be read here. Type a number.'


def test_what_is_typed_stays_within_the_limits() -> None:
    field = _Field("%.1f s", limits=(0.1, 600.0))
    field.type("20 min")
    assert field.value == 600.0
    said = '"20 min" is out of range: it became 600.0 s, the most here.'
    assert number_fields.take_not_read() == said


@pytest.mark.parametrize(
    ("typed", "form", "number"),
    [
        ("90°", "%.1f°", 90.0),
        ("1 rad", "%.1f°", 57.29578),
        ("250 g", "%.3f kg", 0.25),
        ("2.7 g/cm³", "%.0f kg/m³", 2700.0),
        ("80 %", "below %d %%", 80.0),
        ("1.5x", "%.3f×", 1.5),
        ("20 cm", "from %.3g m", 0.2),
        ("2 M", "%.1f M splats", 2.0),
        ("500k", "%.1f M splats", 0.5),
        ("2", "1 metre = %.4g in the file", 2.0),
        ("10 cm", "%.3f", None),  # scene units: no length is known
        ("90°", _METRES, None),
    ],
)
def test_a_field_reads_the_units_of_what_it_shows(
    typed: str, form: str, number: float | None
) -> None:
    assert typed_number(typed, form) == (None if number is None else pytest.approx(number))


def test_coordinates_are_fields_of_their_own() -> None:
    imgui.new_frame()
    imgui.begin("Window")
    assert drag_point("##Point", (1.0, 2.0, 3.0), 0.1, _METRES) == (False, (1.0, 2.0, 3.0))
    imgui.end()
    imgui.end_frame()
