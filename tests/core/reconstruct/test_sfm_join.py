"""Parts of one scene that were placed apart come together again; what does not fit does not."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from gaga_core.geometry import quats_to_matrices
from gaga_core.placing.join import join_parts, similarity
from gaga_core.placing.ladder import is_well_joined
from tests.captures.placing import off_after_alignment
from tests.core.conftest import PlacedRoom


def part_of(room: PlacedRoom, chosen: range, moved: pycolmap.Sim3d) -> pycolmap.Reconstruction:
    """The room with some of its photos only, in a frame of its own."""
    model = pycolmap.Reconstruction(room.workspace / "model")
    names = sorted(image.name for image in model.images.values())
    for image in list(model.images.values()):
        if names.index(image.name) not in chosen:
            model.deregister_frame(image.frame_id)
    model.transform(moved)
    return model


def elsewhere() -> pycolmap.Sim3d:
    turn = pycolmap.Rotation3d(np.array([0.3, -0.5, 0.1, 0.8]))
    return pycolmap.Sim3d(2.5, turn, np.array([4.0, -1.0, 7.0]))


def join(room: PlacedRoom, *parts: pycolmap.Reconstruction) -> list[pycolmap.Reconstruction]:
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = 2, 0
    return join_parts(parts, room.workspace / "database.db", room.workspace / "photos", options)


@pytest.mark.parametrize("second", [range(4, 8), range(3, 8)])
def test_two_parts_become_one_model(placed_room: PlacedRoom, second: range) -> None:
    """With a photo in both, and with verified matches alone."""
    parts = (
        part_of(placed_room, range(4), pycolmap.Sim3d()),
        part_of(placed_room, second, elsewhere()),
    )
    (joined,) = join(placed_room, *parts)
    places = {image.name: image.projection_center() for image in joined.images.values()}
    assert len(places) == joined.num_reg_images() == 8
    mine = np.array([places[camera.name] for camera in placed_room.cameras])
    true = np.array([camera.position for camera in placed_room.cameras])
    assert off_after_alignment(mine, true) < 0.01
    assert joined.compute_mean_reprojection_error() < 1


def test_a_photo_in_both_is_where_more_points_hold_it(placed_room: PlacedRoom) -> None:
    """The last photo that a mapping places before it ends is often wrong."""
    first = part_of(placed_room, range(5), pycolmap.Sim3d())
    shared = next(i for i in first.images.values() if i.name == placed_room.cameras[4].name)
    for k, point in enumerate(shared.points2D):
        if point.has_point3D():
            first.delete_observation(shared.image_id, k)
    pose = shared.cam_from_world()
    about = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0, 1.0, 0, 0])), np.ones(3))
    first.frame(shared.frame_id).rig_from_world = about * pose  # looks the other way
    (joined,) = join(placed_room, first, part_of(placed_room, range(4, 8), elsewhere()))
    places = {image.name: image.projection_center() for image in joined.images.values()}
    mine = np.array([places[camera.name] for camera in placed_room.cameras])
    true = np.array([camera.position for camera in placed_room.cameras])
    assert off_after_alignment(mine, true) < 0.01


def test_points_that_do_not_agree_join_nothing() -> None:
    rng = np.random.default_rng(0)
    source, target = rng.normal(0, 1, (2, 40, 3))
    assert similarity(source, target, 0.05) is None
    to_target = similarity(source, source * 2 + 1, 0.05)
    assert to_target is not None
    assert np.allclose(to_target.matrix(), np.c_[2 * np.eye(3), np.ones(3)])
    assert similarity(source[:5], source[:5], 0.05) is None


def test_matches_between_the_parts_have_the_last_word(placed_room: PlacedRoom) -> None:
    whole = placed_room.facts
    parts = [replace(whole, names=whole.names[:4]), replace(whole, names=whole.names[4:])]
    assert is_well_joined(whole, parts)
    poses = whole.poses.copy()
    turn = quats_to_matrices(np.array([[0.98, 0.0, 0.2, 0.0]]))[0]
    poses[4:, :, :3] = poses[4:, :, :3] @ turn
    assert not is_well_joined(replace(whole, poses=poses), parts)
    apart = np.zeros(len(whole.pairs), bool)
    unlinked = replace(
        whole,
        pairs=whole.pairs[apart],
        pair_matches=whole.pair_matches[apart],
        match_views=np.zeros((0, 2), np.int64),
        match_points=np.zeros((0, 2), np.int64),
        match_rays=np.zeros((0, 2, 3)),
    )
    assert not is_well_joined(unlinked, parts)
