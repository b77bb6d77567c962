"""Switches of `gaga export` that change nothing of what is exported are refused."""

from dataclasses import fields
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from gaga_core.cli.export import GOES_WITH, ExportCommand
from gaga_core.cli.main import main
from gaga_core.export.options import ExportOptions
from gaga_core.export.simulation.settings import SimulationConfig

_VALUES = {  # of each switch, another than its default
    "format": ["coco"],
    "form": ["ply"],
    "mesh_file": ["obj"],
    "voxels": ["32"],
    "triangles": ["500"],
    "only": ["3"],
    "with_children": [],
    "folder": ["Kitchen"],
    "groups": [],
    "sh_degree": ["1"],
    "crop": ["0", "0", "0", "1", "1", "1"],
    "centre": [],
    "ground": [],
    "scale": ["2"],
    "decimate": ["0.5"],
    "as_trained": [],
    "identity": [],
    "to": ["usd"],
    "mass": ["3=0.5"],
    "object_density": ["3=800"],
    "density": ["900"],
    "friction": ["0.5"],
    "parts": ["4"],
    "concavity": ["0.1"],
}
_WHAT = get_args(get_type_hints(ExportCommand)["what"])


def test_of_every_switch_it_is_known_what_it_goes_with() -> None:
    own = {field.name for field in fields(ExportCommand)}
    changes = {field.name for field in fields(ExportOptions)} - {"up", "page"}
    changes |= {field.name for field in fields(SimulationConfig)}
    plain = {"scene", "out", "what", "json", "options", "simulation"}
    assert (own | changes) - plain == set(GOES_WITH) == set(_VALUES)
    assert {what for goes_with in GOES_WITH.values() for what in goes_with} == set(_WHAT)


@pytest.mark.parametrize("what", _WHAT)
def test_a_switch_that_changes_nothing_is_refused_before_anything_is_read(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--identity`, `--form` and `--groups` said nothing for masks and cameras."""
    call = ["export", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out.ply"), "--what", what]
    refused = [name for name, goes_with in GOES_WITH.items() if what not in goes_with]
    assert refused
    for name in refused:
        switch = f"--{name.replace('_', '-')}"
        assert main([*call, switch, *_VALUES[name]]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith(f"gaga: {switch} goes with --what {GOES_WITH[name][0]}")
        assert said.err.count("\n") == 1
    assert main(call) == 1, "the scene is not there"
    assert "nowhere" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("form", "name", "fits"),
    [
        ("ply", "a.glb", False),
        ("glb", "a.ply", False),
        ("spz", "a.sog", False),
        ("compressed-ply", "a.ply", True),
        ("spz4", "a.spz", True),
        ("ply", "a.point", True),
    ],
)
def test_a_form_that_the_name_contradicts_is_refused(
    form: str, name: str, fits: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A .ply was written into a .glb, and replaced a good one."""
    call = ["export", str(tmp_path / "nowhere"), "--out", str(tmp_path / name), "--form", form]
    assert main(call) == (1 if fits else 2)
    assert ("nowhere" if fits else f"--form {form}") in capsys.readouterr().err
