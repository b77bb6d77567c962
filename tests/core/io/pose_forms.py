"""Cameras of a scene in the forms of other programs, as their documentation has them."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.io.cameras.cameras_json import write_cameras_json
from gaga_core.io.cameras.colmap import write_colmap
from tests.scenes import orbit_cameras

SIZE = (64, 48)
GL: DoubleArray = np.diag([1.0, -1, -1, 1])


def cameras() -> tuple[Camera, ...]:
    """Ten views with names that sort as they are numbered, in no special frame."""
    rng = np.random.default_rng(3)
    found = []
    for i, camera in enumerate(orbit_cameras(10)):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.linalg.det(turn)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, camera.cam_from_world[:3, 3] + rng.normal(size=3)
        K = np.array([[70.5, 0, 31.25], [0, 70.5, 25.5], [0, 0, 1]])
        found.append(Camera(K, pose, *SIZE, f"{i:05d}.png"))
    return tuple(found)


def photos(folder: Path) -> Path:
    """Pictures of those views."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(10):
        Image.new("RGB", SIZE, (i, 0, 0)).save(folder / f"{i:05d}.png")
    return folder


def _c2w(camera: Camera) -> DoubleArray:
    """Of a camera with OpenGL's axes."""
    return np.linalg.inv(camera.cam_from_world) @ GL


def _frames(views: Sequence[Camera], name: Callable[[Camera], str]) -> list[dict[str, object]]:
    return [{"file_path": name(c), "transform_matrix": _c2w(c).tolist()} for c in views]


def _nerfstudio(root: Path, views: Sequence[Camera]) -> Path:
    applied = np.eye(4)
    applied[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    scaled = np.diag([2.5, 2.5, 2.5, 1.0]) @ applied
    frames = _frames(views, lambda c: f"./images/{c.name}")
    for frame, camera in zip(frames, views, strict=True):
        moved = scaled @ _c2w(camera)
        moved[:3, :3] /= 2.5
        frame["transform_matrix"] = moved.tolist()
        frame |= {"w": 64, "h": 48, "fl_x": 70.5, "fl_y": 70.5, "cx": 31.25, "cy": 25.5}
        frame["depth_file_path"] = f"depth/{camera.name}"
    whole = {
        "camera_model": "OPENCV",
        "k1": 0.01,
        "frames": frames,
        "applied_transform": applied[:3].tolist(),
        "applied_scale": 2.5,
    }
    return _text(root / "any_name.json", json.dumps(whole))


def _instant_ngp(root: Path, views: Sequence[Camera]) -> Path:
    whole = {
        "camera_angle_x": 2 * np.arctan(32 / 70.5),
        "fl_x": 70.5,
        "fl_y": 70.5,
        "cx": 31.25,
        "cy": 25.5,
        "w": 64,
        "h": 48,
        "k1": 0,
        "frames": _frames(views, lambda c: f"images\\{c.name}"),
    }
    return _text(root / "transforms.json", json.dumps(whole))


def _blender(root: Path, views: Sequence[Camera]) -> Path:
    angle = 2 * np.arctan(32 / 70.5)
    for split, some in (("train", views[:7]), ("test", views[7:])):
        frames = _frames(some, lambda c: f"./photos/{Path(c.name).stem}")
        whole = {"camera_angle_x": angle, "frames": frames}
        _text(root / f"transforms_{split}.json", json.dumps(whole))
    return root / "transforms_train.json"


def _colmap(root: Path, views: Sequence[Camera]) -> Path:
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True)
    write_colmap(folder, views, np.ones((1, 3)), np.full((1, 3), 9, np.uint8))
    return folder


def _colmap_rig(root: Path, views: Sequence[Camera]) -> Path:
    """Two cameras side by side, five times, in binary."""
    model = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    for i in (1, 2):
        params = [70.5, 70.5, 31.25, 25.5, 0.1, 0, 0, 0]
        camera = pycolmap.Camera(model="OPENCV", width=64, height=48, params=params, camera_id=i)
        model.add_camera(camera)
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, i)
        if i == 1:
            rig.add_ref_sensor(sensor)
        else:
            rig.add_sensor(
                sensor, _rigid(views[1].cam_from_world @ np.linalg.inv(views[0].cam_from_world))
            )
    model.add_rig(rig)
    for k in range(5):
        frame = pycolmap.Frame(frame_id=k + 1, rig_id=1)
        frame.rig_from_world = _rigid(views[2 * k].cam_from_world)
        images = []
        for i in (1, 2):
            name, number = views[2 * k + i - 1].name, 2 * k + i
            image = pycolmap.Image(name=name, camera_id=i, image_id=number)
            image.frame_id = k + 1
            frame.add_data_id(image.data_id)
            images.append(image)
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
    folder = root / "model"
    folder.mkdir()
    model.write(str(folder))
    return folder


def rig_views() -> tuple[Camera, ...]:
    """The views of `_colmap_rig`: each second one stands next to the one before, as the first."""
    views = list(cameras())
    right = views[1].cam_from_world @ np.linalg.inv(views[0].cam_from_world)
    return tuple(
        Camera(
            c.K, right @ views[i - 1].cam_from_world if i % 2 else c.cam_from_world, *SIZE, c.name
        )
        for i, c in enumerate(views)
    )


def _rigid(pose: DoubleArray) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3])


def _realityscan_csv(root: Path, views: Sequence[Camera]) -> Path:
    lines = ["#cameras 10", "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for camera in views:
        R = _c2w(camera)[:3, :3]  # Rz(-heading) Rx(pitch) Ry(roll)
        pitch = np.arcsin(np.clip(R[2, 1], -1, 1))
        heading = np.arctan2(R[0, 1], R[1, 1])
        roll = np.arctan2(-R[2, 0], R[2, 2])
        angles = np.degrees([heading, pitch, roll])
        inner = (70.5 / 64 * 36, (31.25 - 32) / 64, (25.5 - 24) / 64, 0, 0, 0, 0, 0, 0)
        values = (*camera.position, *angles, *inner)
        lines.append(",".join([camera.name, *(repr(float(v)) for v in values)]))
    return _text(root / "cameras.csv", "\n".join(lines) + "\n")


def _realityscan_xmp(root: Path, views: Sequence[Camera]) -> Path:
    folder = root / "images"
    for camera in views:
        rotation = " ".join(repr(float(v)) for v in camera.cam_from_world[:3, :3].ravel())
        place = " ".join(repr(float(v)) for v in camera.position)
        text = f"""<x:xmpmeta xmlns:x="adobe:ns:meta/">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <rdf:Description xcr:Version="3" xcr:PosePrior="exact" xcr:DistortionModel="brown3"
   xcr:FocalLength35mm="{70.5 / 64 * 36!r}" xcr:PrincipalPointU="{(31.25 - 32) / 64!r}"
   xcr:PrincipalPointV="{(25.5 - 24) / 64!r}"
   xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">
   <xcr:Rotation>{rotation}</xcr:Rotation>
   <xcr:Position>{place}</xcr:Position>
   <xcr:DistortionCoeficients>0.01 0 0 0 0 0</xcr:DistortionCoeficients>
  </rdf:Description>
 </rdf:RDF>
</x:xmpmeta>"""
        _text(folder / f"{Path(camera.name).stem}.xmp", text)
    return folder


def _bundler(root: Path, views: Sequence[Camera]) -> Path:
    lines = ["# Bundle file v0.3", f"{len(views)} 0"]
    for camera in views:
        pose = GL @ camera.cam_from_world
        lines.append("70.5 0.01 0")
        lines += [" ".join(repr(float(v)) for v in row) for row in pose[:3, :3]]
        lines.append(" ".join(repr(float(v)) for v in pose[:3, 3]))
    _text(root / "list.txt", "\n".join(f"images/{c.name} 0 70.5" for c in views))
    return _text(root / "bundle.out", "\n".join(lines) + "\n")


def _metashape(root: Path, views: Sequence[Camera]) -> Path:
    world = np.eye(4)  # from the chunk
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    world[:3, :3] = 3.0 * turn * np.linalg.det(turn)
    world[:3, 3] = (1, -2, 0.5)
    entries = []
    for i, camera in enumerate(views):
        pose = np.linalg.inv(world) @ np.linalg.inv(camera.cam_from_world)
        pose[:3, :3] *= 3.0
        row = " ".join(repr(float(v)) for v in pose.ravel())
        label = Path(camera.name).stem
        entries.append(
            f'<camera id="{i}" sensor_id="0" label="{label}"><transform>{row}</transform></camera>'
        )
    rotation = " ".join(repr(float(v)) for v in (world[:3, :3] / 3.0).ravel())
    text = f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
 <sensors><sensor id="0" label="cam" type="frame"><resolution width="64" height="48"/>
  <calibration type="frame" class="adjusted"><resolution width="64" height="48"/><f>70.5</f>
   <cx>-0.75</cx><cy>1.5</cy><k1>0.01</k1><p1>0.002</p1><p2>0.003</p2></calibration>
 </sensor></sensors>
 <cameras>{"".join(entries)}<camera id="99" sensor_id="0" label="not_aligned"/></cameras>
 <transform><rotation>{rotation}</rotation><translation>1 -2 0.5</translation>
 <scale>3.0</scale></transform></chunk></document>"""
    return _text(root / "export.xml", text)


def _pix4d(root: Path, views: Sequence[Camera]) -> Path:
    head = """fileName imageWidth imageHeight
camera matrix K [3x3]
radial distortion [3x1]
tangential distortion [2x1]
camera position t [3x1]
camera rotation R [3x3]
camera model m = K [R|-Rt] X
"""
    lines = [head]
    for camera in views:
        lines.append(f"{camera.name} 64 48")
        rows = [*camera.K, (0.01, 0, 0), (0, 0), camera.position, *camera.cam_from_world[:3, :3]]
        lines += [" ".join(repr(float(v)) for v in row) for row in rows]
    return _text(root / "p_calibrated_camera_parameters.txt", "\n".join(lines) + "\n")


def _p4d(root: Path, views: Sequence[Camera]) -> Path:
    folder = root / "p" / "1_initial" / "params"
    folder.mkdir(parents=True)
    _pix4d(folder, views)
    return _text(root / "p.p4d", "<pix4dmapper><images/></pix4dmapper>")


def _opf(root: Path, views: Sequence[Camera]) -> Path:
    listed, found = [], []
    for i, camera in enumerate(views):
        R = _c2w(camera)[:3, :3]  # Rx(omega) Ry(phi) Rz(kappa)
        phi = np.arcsin(np.clip(R[0, 2], -1, 1))
        omega, kappa = np.arctan2(-R[1, 2], R[2, 2]), np.arctan2(-R[0, 1], R[0, 0])
        listed.append({"id": i, "uri": f"images/{camera.name}"})
        angles = np.degrees([omega, phi, kappa]).tolist()
        found.append(
            {
                "id": i,
                "sensor_id": 7,
                "orientation_deg": angles,
                "position": camera.position.tolist(),
            }
        )
    lens = {"type": "perspective", "principal_point_px": [31.25, 25.5], "focal_length_px": 70.5}
    lens |= {"radial_distortion": [0.01, 0, 0], "tangential_distortion": [0, 0]}
    sensors = [{"id": 7, "internals": lens}]
    _text(root / "calibrated.json", json.dumps({"sensors": sensors, "cameras": found}))
    _text(root / "list.json", json.dumps({"cameras": listed}))
    kinds = {"calibrated.json": "calibrated-cameras", "list.json": "camera-list"}
    resources = [{"uri": n, "format": f"application/opf-{k}+json"} for n, k in kinds.items()]
    whole = {"format": "application/opf-project+json", "items": [{"resources": resources}]}
    return _text(root / "project.opf", json.dumps(whole))


def _polycam(root: Path, views: Sequence[Camera]) -> Path:
    folder = root / "cameras"
    folder.mkdir()
    for camera in views:
        pose = _c2w(camera)
        values = {f"t_{i}{j}": pose[i, j] for i in range(3) for j in range(4)}
        values |= {"fx": 70.5, "fy": 70.5, "cx": 31.25, "cy": 25.5, "width": 64, "height": 48}
        _text(folder / f"{Path(camera.name).stem}.json", json.dumps(values | {"blur_score": 9.1}))
    return folder


def _scanner_app(root: Path, views: Sequence[Camera]) -> Path:
    folder = root / "images"
    for camera in views:
        stem = f"frame_{Path(camera.name).stem}"
        (folder / camera.name).rename(folder / f"{stem}.png")
        pose, K = _c2w(camera).ravel().tolist(), camera.K.ravel().tolist()
        values = {"cameraPoseARFrame": pose, "intrinsics": K, "frame_index": 1}
        _text(folder / f"{stem}.json", json.dumps(values))
    _text(folder / "frame_99999.json", json.dumps(values))  # depth without a photo
    return folder


def _record3d(root: Path, views: Sequence[Camera]) -> Path:
    poses = []
    for camera in views:
        c2w = _c2w(camera)
        x, y, z, w = pycolmap.Rotation3d(c2w[:3, :3]).quat
        poses.append([x, y, z, w, *c2w[:3, 3]])
    whole = {"w": 64, "h": 48, "fps": 60, "K": views[0].K.T.ravel().tolist(), "poses": poses}
    return _text(root / "metadata", json.dumps(whole))


def stray(root: Path, views: Sequence[Camera]) -> Path:
    """Views by their order, with poses in OpenCV's axes."""
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for i, camera in enumerate(views):
        c2w = np.linalg.inv(camera.cam_from_world)
        values = (*c2w[:3, 3], *pycolmap.Rotation3d(c2w[:3, :3]).quat)
        lines.append(", ".join([f"{i / 60}", f"{i:06d}", *(repr(float(v)) for v in values)]))
    rows = [", ".join(repr(float(v)) for v in row) for row in views[0].K]
    _text(root / "camera_matrix.csv", "\n".join(rows) + "\n")
    return _text(root / "odometry.csv", "\n".join(lines) + "\n")


def _cameras_json(root: Path, views: Sequence[Camera]) -> Path:
    write_cameras_json(root / "cameras.json", views)
    return root / "cameras.json"


def _llff(root: Path, views: Sequence[Camera]) -> Path:
    rows = []
    for camera in views:
        c2w = np.linalg.inv(camera.cam_from_world)
        right, down, forward, place = c2w[:3].T
        sizes = np.array([96.0, 128.0, 141.0])  # of photos twice as large
        pose = np.stack([down, right, -forward, place, sizes], axis=1)
        rows.append(np.r_[pose.ravel(), 0.1, 10.0])
    np.save(root / "poses_bounds.npy", np.array(rows))
    return root / "poses_bounds.npy"


def _text(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


Form = tuple[Callable[[Path, Sequence[Camera]], Path], bool, tuple[int, int, int] | None, bool]
FORMS: dict[str, Form] = {  # writer, metres known, up, principal point written
    "nerfstudio": (_nerfstudio, True, (0, 1, 0), True),
    "instant-ngp": (_instant_ngp, False, None, True),
    "Blender": (_blender, False, (0, 0, 1), False),
    "COLMAP": (_colmap, False, None, True),
    "COLMAP rig": (_colmap_rig, False, None, True),
    "RealityScan CSV": (_realityscan_csv, False, (0, 0, 1), True),
    "RealityScan XMP": (_realityscan_xmp, False, (0, 0, 1), True),
    "Bundler": (_bundler, False, None, False),
    "Metashape": (_metashape, True, (0, 0, 1), True),
    "Pix4D": (_pix4d, True, (0, 0, 1), True),
    "Pix4D project": (_p4d, True, (0, 0, 1), True),
    "OPF": (_opf, True, (0, 0, 1), True),
    "Polycam": (_polycam, True, (0, 1, 0), True),
    "3D Scanner App": (_scanner_app, True, (0, 1, 0), True),
    "Record3D": (_record3d, True, (0, 1, 0), True),
    "Stray Scanner": (stray, True, (0, 1, 0), True),
    "3DGS": (_cameras_json, False, None, False),
    "LLFF": (_llff, False, None, False),
}
