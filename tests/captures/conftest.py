"""The long captures run when they are asked for: make captures, or GAGA_LONG_CAPTURES=1."""

import os

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the captures that take minutes, unless they are asked for."""
    if os.environ.get("GAGA_LONG_CAPTURES") == "1":
        return
    skip = pytest.mark.skip(reason="minutes each: make captures")
    for item in items:
        if item.get_closest_marker("capture") is not None:
            item.add_marker(skip)
