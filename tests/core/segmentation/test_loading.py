"""Weights that are pickles: damaged or malicious ones are a sentence, and nothing is executed."""

import os
import pickle
from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from gaga_core.segmentation.loading import load_folder


class _Malicious:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.mark),)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A model's folder without weights."""
    from transformers import CLIPConfig

    CLIPConfig().save_pretrained(tmp_path / "model")
    return tmp_path / "model"


@pytest.mark.parametrize("what", ["empty", "text", "cut zip", "pickle", "malicious"])
def test_bad_weights_are_a_sentence(folder: Path, tmp_path: Path, what: str) -> None:
    mark = tmp_path / "executed"
    contents = {
        "empty": b"",
        "text": b"not found",
        "cut zip": b"PK\x03\x04" + bytes(100),
        "pickle": b"\x80\x04garbage",
        "malicious": pickle.dumps({"weight": _Malicious(mark)}),
    }
    (folder / "pytorch_model.bin").write_bytes(contents[what])
    with pytest.raises(GagaError, match="cannot be loaded"):
        load_folder("text_image", folder)
    assert not mark.exists()
