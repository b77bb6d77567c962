"""What a line of the object list shows."""

import pytest

from gaga_studio.ui.panels.rows import compact


@pytest.mark.parametrize(
    ("n", "text"),
    [
        (999, "999"),
        (4_449, "4.4k"),
        (9_949, "9.9k"),
        (9_950, "10k"),
        (15_797, "16k"),
        (999_499, "999k"),
        (999_500, "1.0M"),
        (3_149_000, "3.1M"),
    ],
)
def test_large_numbers_are_rounded_to_four_letters(n: int, text: str) -> None:
    """15,797 splats were 15k."""
    assert compact(n) == text
