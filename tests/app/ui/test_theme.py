"""Colors of both themes: none is left to the toolkit, words stand out from what is behind them."""

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from imgui_bundle import ImVec4, imgui

from gaga_core.scene.folders import Folders
from gaga_core.scene.objects import folder_colors, group_colors
from gaga_studio.ui.kit import theme


def luminance(rgb: Sequence[float]) -> float:
    """Relative luminance of sRGB (WCAG 2.2)."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb[:3]]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: Sequence[float], b: Sequence[float]) -> float:
    low, high = sorted((luminance(a), luminance(b)))
    return (high + 0.05) / (low + 0.05)


def values(color: ImVec4) -> tuple[theme.Rgba, theme.Rgba]:
    """Dark and light."""
    return next((dark, light) for held, dark, light in theme._BOTH if held is color)


def test_every_color_of_the_toolkit_is_the_themes() -> None:
    assert {name for name in imgui.Col_.__members__ if name != "count"} == theme._COLORS.keys()


@pytest.mark.parametrize("is_light", [False, True], ids=["dark", "light"])
def test_words_stand_out(is_light: bool) -> None:
    """4.5 to 1 for words (WCAG 2.2, AA); 3 to 1 for what is faint on purpose."""
    for text in ("TEXT", "DIM", "GOOD", "WARN", "BAD", "FAINT"):
        least = 3.0 if text == "FAINT" else 4.5
        for ground in ("PANEL", "BACK", "POPUP"):
            front = values(getattr(theme, text))[is_light]
            behind = values(getattr(theme, ground))[is_light]
            assert contrast(front, behind) >= least, f"{text} on {ground}"


@pytest.mark.parametrize("is_light", [False, True], ids=["dark", "light"])
def test_values_are_read_over_the_knobs_of_sliders(is_light: bool) -> None:
    """At rest, hovered and dragged: the value of a slider is drawn over its knob."""
    text = values(theme.TEXT)[is_light]
    for field, knob in (
        ("frame_bg", "slider_grab"),
        ("frame_bg_hovered", "slider_grab"),
        ("frame_bg_active", "slider_grab_active"),
    ):
        ground, over = (values(theme._COLORS[name])[is_light] for name in (field, knob))
        seen = [a * over[3] + b * (1 - over[3]) for a, b in zip(over[:3], ground[:3], strict=True)]
        assert contrast(text, seen) >= 4.5, f"value over {knob} on {field}"


@pytest.fixture
def either(request: pytest.FixtureRequest) -> Iterator[bool]:
    """Whether the panels are those of the light theme."""
    held = theme.PANEL
    held.x, held.y, held.z, _ = values(held)[request.param]
    yield request.param
    held.x, held.y, held.z, _ = values(held)[False]


@pytest.mark.parametrize("either", [False, True], ids=["dark", "light"], indirect=True)
def test_dots_of_objects_are_seen(either: bool) -> None:
    """A rim of 3 to 1 around those that the panel hides: in no folder, dark ones of the palette."""
    panel = values(theme.PANEL)[either]
    none = folder_colors(Folders(), np.array([1], np.int32))
    palette = group_colors(np.arange(1, 300, dtype=np.int32))
    for color in (*none, (0, 0, 0), (1, 1, 1), panel[:3], *palette):
        rim = theme.rim(color)
        seen = values(rim)[either] if rim is not None else color
        assert contrast(seen, panel) >= 3, color
    assert theme.rim(panel[:3]) is not None
    plain = [contrast(color, panel) >= 3 for color in palette]
    assert [theme.rim(color) is None for color in palette] == plain, "no rim that is not needed"
