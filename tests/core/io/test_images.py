"""Pictures that cannot be read are a sentence."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from gaga_core.errors import GagaError
from gaga_core.io.images import open_image


def test_a_picture_that_claims_more_than_the_memory_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "a.png")

    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(PngImagePlugin.PngImageFile, "load_end", full)
    with pytest.raises(GagaError, match="too large"):
        open_image(tmp_path / "a.png")
