"""The command ``gaga`` as a person or a script uses it."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

import gaga_core
from gaga_core.cli.main import AnyCommand, main
from gaga_core.cli.output import follow, say_what_a_project_keeps, say_what_is_not_drawn
from gaga_core.errors import GagaError
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.ply import read_ply
from gaga_core.pipeline.settings import IdentitySettings
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.project import open_path_stage, save_project
from tests.app.folders import write_scene
from tests.core.cli.calls import Capture, answer, refusal


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder that was associated by the command."""
    root = tmp_path_factory.mktemp("cli") / "scene"
    write_scene(root)
    assert main(["associate", str(root), "--preset", "paper"]) == 0
    return root


@pytest.mark.parametrize("command", get_args(AnyCommand), ids=lambda kind: get_args(kind)[1].name)
def test_every_command_explains_each_of_its_options(command: object, capsys: Capture) -> None:
    """Each has a sentence, and ends with what is left out when it is not given."""
    name = get_args(command)[1].name
    with pytest.raises(SystemExit) as caught:
        main([name, "--help"])
    assert caught.value.code == 0
    said = capsys.readouterr().out
    assert name == "models" or "--json" in said
    assert not re.search(r"^\W{0,4}--[\w-]+(?:, --[\w-]+)?(?: \S+)?\s*\(default", said, re.M)


@pytest.mark.parametrize(("adds", "cure"), [(True, "Add new photos"), (False, "you associate")])
def test_it_is_said_how_a_saved_project_gets_new_groups(
    tmp_path: Path, capsys: Capture, adds: bool, cure: str
) -> None:
    say_what_a_project_keeps(tmp_path, adds=adds)
    (tmp_path / "gaga").mkdir()
    (tmp_path / "gaga" / "project.json").write_text("{}")
    assert capsys.readouterr().err == ""
    say_what_a_project_keeps(tmp_path, adds=adds)
    assert cure in capsys.readouterr().err
    say_what_is_not_drawn(tmp_path)
    assert "not drawn" in capsys.readouterr().err


def test_info_counts_what_there_is(scene: Path, capsys: Capture) -> None:
    values = answer(capsys, "info", str(scene))
    lone = answer(capsys, "info", str(scene / "point_cloud.ply"))
    splats = read_ply(scene / "point_cloud.ply")
    assert values["gaussians"] == lone["gaussians"] == len(splats)
    assert lone["sh_degree"] == splats.sh_degree
    assert values["views"] == 8
    with np.load(scene / "gaga" / "labels.npz") as stored:
        assert values["groups"] == len(np.unique(stored["labels"][stored["labels"] > 0]))


def test_groups_of_the_test_views_match_the_masks(
    scene: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "groups"
    values = answer(capsys, "render", str(scene), "--what", "groups", "--out", str(out))
    assert values["pictures"] == len(list(out.glob("*.png"))) == 1
    scores = answer(
        capsys, "evaluate", "--pred", str(out), "--gt", str(scene / "masks" / "made"),
        "--scene", str(scene), "--views", "test",
    )  # fmt: skip
    without_void = scores["without_void"]
    assert isinstance(without_void, dict)
    assert without_void["iou"] > 0.85
    assert without_void["recall"] == 1


def test_settings_of_the_association_are_switches(tmp_path: Path, capsys: Capture) -> None:
    root = tmp_path / "scene"
    write_scene(root)
    paper = ("associate", str(root), "--preset", "paper")
    published = answer(capsys, *paper)
    same = ("--threshold", "0.1", "--inlier-factor", "1", "--depth", "expected", "--order", "name")
    seconds = {"seconds", "seconds_per_view"}
    again = answer(capsys, *paper, *same)
    assert {k: v for k, v in again.items() if k not in seconds} == {
        k: v for k, v in published.items() if k not in seconds
    }
    strict = answer(capsys, *paper, "--threshold", "1")
    assert strict["groups"] > published["groups"]  # type: ignore[operator]
    assert "not in (0, 1]" in refusal(capsys, *paper, "--threshold", "7")
    robust = ("associate", str(root), "--preset", "robust", "--depth", "expected")
    assert "needs the depth 'median'" in refusal(capsys, *robust)


def test_preset_paper_is_the_whole_method(tmp_path: Path, capsys: Capture) -> None:
    """Association of 3.2, identities trained from zeros, labels by their classifier."""
    assert IdentitySettings().config("robust", "paper").paper.iterations == 10_000
    root = tmp_path / "scene"
    write_scene(root)
    few = ("--lift-iterations", "20", "--void", "train", "--pseudo", "bank")
    assert main(["run", str(root), *few]) == 0
    assert _entry(root, "associate")["config"]["preset"] == "robust"  # type: ignore[index]
    assert _entry(root, "lift")["mode"] == "vote"
    values = answer(capsys, "run", str(root), "--preset", "paper", *few)
    assert values["stages_run"] == ["associate", "lift", "render"]
    config = _entry(root, "associate")["config"]
    assert config["preset"] == "paper"  # type: ignore[index]
    lift = _entry(root, "lift")
    assert (lift["mode"], lift["steps"]) == ("paper", 19)
    assert lift["config"]["rows"]["train_void"]  # type: ignore[index]
    assert answer(capsys, "run", str(root), "--preset", "paper", *few)["stages_run"] == []
    with np.load(root / "gaga" / "identity.npz") as stored:
        trained = stored["labels"]
    with np.load(root / "gaga" / "labels.npz") as stored:
        voted = stored["labels"]
    assert not np.array_equal(trained, voted)
    for ops, want in (([], trained), ([{"op": "labels", "from": "votes"}], voted)):
        (tmp_path / "script.json").write_text(json.dumps(ops))
        target = str(tmp_path / "out.ply")
        script = ("--script", str(tmp_path / "script.json"), "--groups")
        answer(capsys, "edit", str(root), target, *script)
        assert np.array_equal(read_ply(Path(target)).extra["group"], want)


def _entry(root: Path, name: str) -> dict[str, object]:
    report = json.loads((root / "gaga" / "report.json").read_text())
    return report[name]


def test_a_missing_prediction_is_named(scene: Path, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "none").mkdir()
    gt = str(scene / "masks" / "made")
    assert main(["evaluate", "--pred", str(tmp_path / "none"), "--gt", gt]) == 0
    captured = capsys.readouterr()
    assert "8 predictions are missing" in captured.err


def test_recorded_edits_give_the_edited_file(scene: Path, tmp_path: Path, capsys: Capture) -> None:
    with np.load(scene / "gaga" / "labels.npz") as stored:
        labels = stored["labels"]
    gone, moved = (int(g) for g in np.unique(labels[labels > 0])[:2])
    script = tmp_path / "edits.json"
    script.write_text(
        json.dumps(
            [
                {"op": "delete", "groups": [gone]},
                {"op": "move", "groups": [moved], "by": [0, 0, 2]},
            ]
        )
    )
    target = tmp_path / "out.ply"
    values = answer(capsys, "edit", str(scene), str(target), "--script", str(script), "--groups")
    before, after = read_ply(scene / "point_cloud.ply"), read_ply(target)
    kept = labels != gone
    assert values["gaussians"] == len(after) == kept.sum()
    want = before.means[kept] + np.where(labels[kept] == moved, 2, 0)[:, None] * [0, 0, 1]
    assert np.allclose(after.means, want, atol=1e-5)
    assert np.array_equal(after.extra["group"], labels[kept])


def test_the_size_is_that_of_what_is_left(scene: Path, tmp_path: Path, capsys: Capture) -> None:
    """Deleted splats counted, and what was moved stayed where it had been."""
    edited = gaga_core.open(scene)
    first, second = list(edited.objects)[:2]
    edited.objects[first].delete()
    edited.objects[second].move((3, 0, 0))
    saved, out = edited.save(tmp_path / "saved.gaga"), tmp_path / "out.ply"
    answer(capsys, "export", str(saved), "--out", str(out))
    whole, left = answer(capsys, "info", str(saved)), answer(capsys, "info", str(out))
    assert whole["size"] == left["size"] != answer(capsys, "info", str(scene))["size"]
    assert f"{left['gaussians']:,} splats" in repr(edited)
    of_export = gaga_core.open(out).save()
    assert str(answer(capsys, "info", str(out))["saved_project"]).startswith(str(of_export))
    edited.edit([{"op": "select_all"}, {"op": "delete"}])
    edited.save()
    assert answer(capsys, "info", str(saved))["size"] == "nothing is visible"


def test_what_is_read_is_not_written_over(scene: Path, tmp_path: Path, capsys: Capture) -> None:
    """Saved edits fitted no file any more, and what they had hidden was gone."""
    script = tmp_path / "script.json"
    script.write_text('[{"op": "delete", "groups": [1]}]')
    model = scene / "point_cloud.ply"
    before = model.read_bytes()
    alias = tmp_path / "alias.ply"
    alias.symlink_to(model)
    for path in (str(model), str(alias)):
        for command in (
            ("edit", str(scene), path, "--script", str(script)),
            ("export", str(scene), "--out", path),
            ("export", path, "--out", str(model), "--sh-degree", "0"),
        ):
            assert "Choose another name" in refusal(capsys, *command)
    with pytest.raises(GagaError, match="Choose another name"):
        gaga_core.open(scene).objects[1].export(model)
    with pytest.raises(GagaError, match="Choose another name"):
        gaga_core.open(model).export(alias)
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "scene.xml").write_text("mine")
    robot = ("--what", "simulation", "--to", "mjcf", "--out", str(tmp_path / "robot"))
    assert "Choose another folder" in refusal(capsys, "export", str(scene), *robot)
    assert (tmp_path / "robot" / "scene.xml").read_text() == "mine"
    parts = tmp_path / "parts"
    answer(capsys, "export", str(scene), "--what", "objects", "--out", str(parts))
    again = ("export", str(parts), "--what", "objects", "--out", str(parts))
    assert "Choose another folder" in refusal(capsys, *again)
    assert model.read_bytes() == before
    masks = scene / "masks" / "made"
    maps = {file.name: file.read_bytes() for file in masks.iterdir()}
    (scene / "depth").mkdir()
    (scene / "depth" / "000.png").write_bytes(b"measured")
    for folder in (masks, scene / "images", scene / "depth"):
        to = ("--what", "masks", "--out", str(folder))
        assert "Choose another place" in refusal(capsys, "export", str(scene), *to)
        to = ("--what", "groups", "--out", str(folder))
        assert "Choose another place" in refusal(capsys, "render", str(scene), *to)
    assert {file.name: file.read_bytes() for file in masks.iterdir()} == maps
    shutil.rmtree(scene / "depth")


def test_folders_are_listed_and_exported(scene: Path, tmp_path: Path, capsys: Capture) -> None:
    project = run_stage(open_path_stage(scene))
    history = History(project.scene)
    history.do(edits.put_in_folder(project.scene, (1, 3), "Kitchen/Cups"))
    history.do(edits.put_in_folder(project.scene, (2,), "Kitchen"))
    history.do(edits.set_parent(project.scene, (3,), 1))
    saved = str(save_project(project, tmp_path / "saved.gaga"))
    values = answer(capsys, "info", saved)
    assert values["folders"] == {"Kitchen": [1, 2, 3], "Kitchen/Cups": [1, 3]}
    listed: Any = values["objects"]
    folders = {entry["group"]: entry["folder"] for entry in listed}
    assert {g for g, path in folders.items() if path} == {1, 2, 3}
    assert main(["info", saved]) == 0
    assert re.search(r"folders +Kitchen: .+, .+, .+; Kitchen/Cups: ", capsys.readouterr().out)
    assert {entry["group"] for entry in listed if entry["parent"] == 1} == {3}
    below = ("--only", "1", "5", "--with-children")
    for switches, wanted in (((), {1, 2, 3}), (("--only", "3", "5"), {3}), (below, {1, 3})):
        out = str(tmp_path / f"out{len(wanted)}")
        to = ("--what", "objects", "--out", out, "--folder", "Kitchen")
        answer(capsys, "export", saved, *to, *switches)
        manifest = json.loads((Path(out) / "groups.json").read_text())
        assert {e["id"]: e["folder"] for e in manifest["groups"]} == {g: folders[g] for g in wanted}
    wrong = ("--what", "objects", "--out", str(tmp_path / "no"), "--folder", "Attic")
    assert "no folder" in refusal(capsys, "export", saved, *wrong)
    alone = ("--what", "objects", "--out", str(tmp_path / "no"), "--with-children")
    assert "--only" in refusal(capsys, "export", saved, *alone, status=2)
    for chosen in (("--folder", "Kitchen"), ("--only", "3")):
        target = str(tmp_path / "whole.ply")
        whole = refusal(capsys, "export", saved, "--out", target, *chosen, status=2)
        assert "--what objects" in whole
    assert not (tmp_path / "whole.ply").exists()


def test_a_page_of_an_edited_scene_calls_objects_by_names_and_words(
    scene: Path, tmp_path: Path, capsys: Capture
) -> None:
    page, script = tmp_path / "a.html", tmp_path / "s.json"
    script.write_text('[{"op": "rename", "groups": [2], "name": "kettle"}]')
    answer(capsys, "edit", str(scene), str(page), "--script", str(script))
    found = re.search(r'id="scene">(.*?)</script>', page.read_text(encoding="utf-8"))
    assert found is not None
    names = {entry["id"]: entry["name"] for entry in json.loads(found[1])["objects"]}
    assert names[2] == "kettle"
    assert not any(name.startswith("group ") for name in names.values())


def test_masks_are_exported_as_the_edited_scene_shows_them(
    scene: Path, tmp_path: Path, capsys: Capture
) -> None:
    values = answer(capsys, "export", str(scene), "--what", "masks", "--out", str(tmp_path / "m"))
    assert values["files"] == 8
    rendered = tmp_path / "r"
    answer(
        capsys, "render", str(scene), "--what", "groups", "--views", "all", "--out", str(rendered)
    )
    for path in rendered.iterdir():
        assert np.array_equal(read_labels(tmp_path / "m" / path.name), read_labels(path))
    lone = str(scene / "point_cloud.ply")
    assert "scene folder" in refusal(
        capsys, "export", lone, "--what", "masks", "--out", str(tmp_path / "n")
    )


def test_identities_are_lifted(scene: Path, tmp_path: Path, capsys: Capture) -> None:
    values = answer(capsys, "lift", str(scene), "--mode", "vote")
    assert values["mode"] == "vote"
    assert (scene / "gaga" / "identity.npz").is_file()
    target = tmp_path / "out.ply"
    answer(capsys, "export", str(scene), "--identity", "--out", str(target))
    columns = [name for name in read_ply(target).extra if name.startswith("obj_dc_")]
    assert columns == [f"obj_dc_{i}" for i in range(16)]
    lone = str(scene / "point_cloud.ply")
    assert "scene folder" in refusal(capsys, "export", lone, "--identity", "--out", str(target))


def test_a_photo_folder_without_masks_or_model_is_told(tmp_path: Path, capsys: Capture) -> None:
    root = tmp_path / "scene"
    write_scene(root, masks=False)
    assert "masks" in refusal(capsys, "associate", str(root))
    assert not (root / "gaga").exists()
    (root / "point_cloud.ply").unlink()
    assert "splats" in refusal(capsys, "info", str(root))


def test_bad_input_is_one_sentence(tmp_path: Path, capsys: Capture) -> None:
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"ply\n")
    script = tmp_path / "e.json"
    script.write_text("[")
    assert "bad.ply" in refusal(capsys, "info", str(bad))
    assert "does not exist" in refusal(capsys, "info", str(tmp_path / "none"))
    assert "damaged" in refusal(capsys, "edit", str(bad), "o.ply", "--script", str(script))
    script.write_text('[{"op": "explode"}]')
    assert "explode" in refusal(capsys, "edit", str(bad), "o.ply", "--script", str(script))
    assert "empty or a new folder" in refusal(capsys, "demo", str(tmp_path))


def test_labels_of_another_model_are_refused(tmp_path: Path, capsys: Capture) -> None:
    root = tmp_path / "scene"
    write_scene(root, n_objects=2)
    (root / "gaga").mkdir()
    np.savez(root / "gaga" / "labels.npz", labels=np.ones(7, np.int32))
    assert "another model" in refusal(capsys, "info", str(root))


# Programs in the background ignore Ctrl-C, and hand that on to what they start. The splats of the
# demo come when it has arrived.
_HEED_CTRL_C = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from gaga_core.io import demo_scene
demo_scene.write_ply = lambda *_: signal.pause()
from gaga_core.cli.main import main
sys.exit(main())
"""


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_half_written(tmp_path: Path) -> None:
    target = tmp_path / "demo"
    process = subprocess.Popen(
        [sys.executable, "-c", _HEED_CTRL_C, "demo", str(target)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    # Once this folder stands, the command is at work, and has something half-written to remove.
    while not list(tmp_path.rglob("masks/sim")):
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert b"Stopped" in said
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_that_a_callback_swallows_ends_the_command_at_the_next_step() -> None:
    done = []

    def stage() -> Stage[None]:
        for i in range(5):
            yield Progress("Work", i, 5)
            if i == 1:
                with suppress(KeyboardInterrupt):  # as a callback of a C library does
                    signal.raise_signal(signal.SIGINT)
            done.append(i)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            follow(stage())
        assert done == [0, 1]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_version() -> None:
    assert main(["--version"]) == 0


_LONG = "n" * 300


@pytest.mark.parametrize(
    "arguments",
    [
        ["info", _LONG],
        ["demo", f"/tmp/{_LONG}"],
        ["associate", _LONG],
        ["lift", _LONG],
        ["run", _LONG],
        ["edit", "a.ply", "b.ply", "--script", _LONG],
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_name_that_is_too_long_is_a_sentence(arguments: list[str], capsys: Capture) -> None:
    assert "too long" in refusal(capsys, *arguments)


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"[NaN]", b"[" * 1_000_000, b'[{"op": 1e999}]', b"\xff"], ids=range(6)
)
def test_a_damaged_script_is_a_sentence(content: bytes, tmp_path: Path, capsys: Capture) -> None:
    script = tmp_path / "script.json"
    script.write_bytes(content)
    said = refusal(capsys, "edit", "a.ply", "b.ply", "--script", str(script))
    assert str(script) in said
    assert "damaged" in said
