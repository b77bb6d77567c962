"""Names of colors: what a person would call them, in any light."""

import numpy as np
import pytest

from gaga_core.query.colors import NAMES, color_table, name_weights


def test_every_color_of_the_table_is_divided_among_the_names() -> None:
    table = color_table()
    share, vivid = table[:, : len(NAMES)], table[:, len(NAMES) :]
    assert np.allclose(share.sum(axis=1), 1, atol=1e-5)
    assert (vivid <= share + 1e-6).all()
    assert (vivid >= 0).all()


@pytest.mark.parametrize(
    ("code", "name"),
    [
        ("e01010", "red"), ("701010", "red"), ("f08020", "orange"), ("f0e020", "yellow"),
        ("20a030", "green"), ("103a18", "green"), ("20b0b0", "turquoise"), ("2050d0", "blue"),
        ("101c60", "blue"), ("8030b0", "purple"), ("f090b8", "pink"), ("6b4226", "brown"),
        ("0000ff", "blue"), ("000080", "blue"), ("4b0082", "purple"), ("8a2be2", "purple"),
        ("0c0ff1", "blue"), ("0000a0", "blue"), ("5a5aff", "blue"),
        ("808080", "grey"), ("050505", "black"), ("fafafa", "white"), ("e4d4ac", "beige"),
    ],
)  # fmt: skip
def test_plain_colors_have_their_names(code: str, name: str) -> None:
    assert _name(code) == name


@pytest.mark.parametrize(
    ("code", "name"),
    [
        ("95a084", "green"), ("909c7f", "green"),  # walls of the demo: beige and grey
        ("8ca3bc", "blue"), ("7a97b0", "blue"),  # a vase in light: turquoise
        ("c0b294", "beige"), ("909a9a", "grey"), ("8a8f85", "grey"),
    ],
)  # fmt: skip
def test_greyish_hues_have_the_name_of_the_hue(code: str, name: str) -> None:
    assert _name(code) == name


@pytest.mark.parametrize("light", [0.45, 0.7, 0.85])
@pytest.mark.parametrize(
    ("code", "name"),
    [("d81e1e", "red"), ("1e56c8", "blue"), ("0000ff", "blue"), ("2a9a34", "green")],
)
def test_shade_does_not_change_the_name_of_a_hue(code: str, name: str, light: float) -> None:
    assert _name(code, light) == name


def _name(code: str, light: float = 1.0) -> str:
    rgb = np.array([int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)])
    return NAMES[int(name_weights(rgb * light).argmax())]
