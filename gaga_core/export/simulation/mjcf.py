"""Bodies and what stays as MJCF, the files of MuJoCo, and as URDF.

Meshes are .obj files in ``meshes``; the splats' files are named as custom text, ``splats:NAME``.
MJCF: mujoco.readthedocs.io, XML reference. URDF: wiki.ros.org/urdf/XML.
"""

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from gaga_core.arrays import AnyArray, DoubleArray
from gaga_core.export.simulation.bodies import GRAVITY, Body, Box, HeightField, World
from gaga_core.geometry import matrices_to_quats
from gaga_core.io.meshes import MeshFile, TriangleMesh, write_mesh

MESHES = "meshes"  # folder next to the file
_GROUND = "static-ground"  # mesh of the height field
_STEP = 0.002  # s, of MuJoCo by default
_VISUAL, _COLLISION = 2, 3  # groups of geoms: as MuJoCo's own models have them
# Spinning and rolling friction, m: of MuJoCo's default, and so that what is round stops rolling.
_SPIN, _ROLL = 0.005, 0.0005


def part_file(body: Body, k: int) -> str:
    """Name of the file of a convex part; a copy has those of its original."""
    return f"{body.copy_of or body.stem}_part_{k}.obj"


def write_meshes(folder: Path, world: World) -> list[str]:
    """Write visual meshes and convex parts as .obj; their names under ``folder``."""
    (folder / MESHES).mkdir(exist_ok=True)
    ground = world.static.ground
    files = {} if ground is None else {f"{_GROUND}.obj": ground.mesh()}
    for body in world.bodies:
        if body.copy_of:
            continue
        files[f"{body.stem}.obj"] = body.mesh
        files |= {part_file(body, k): part for k, part in enumerate(body.parts)}
    for name, mesh in files.items():
        write_mesh(folder / MESHES / name, mesh, MeshFile.OBJ, Path(name).stem)
    return [f"{MESHES}/{name}" for name in files]


def mjcf_of(world: World, splats: dict[str, str], *, inline: bool = False) -> str:
    """MJCF of ``world``; ``splats``: file by the name of a body.

    ``inline``: convex parts stand in the text and nothing is drawn, as for `falling`.
    """
    config = world.config
    assets, parts = list[str](), list[str]()
    for box in world.static.boxes:
        parts.append(f"<geom {_box(box)}/>")
    if world.static.ground is not None:
        field, placed = _ground(world.static.ground)
        assets.append(field)
        parts.append(placed)
    for body in world.bodies:
        geoms, shared = [], body.copy_of or body.stem
        for k, mesh in enumerate(body.parts):
            name = Path(part_file(body, k)).stem
            where = _vertices(mesh) if inline else f'file="{name}.obj"'
            assets += [] if body.copy_of else [f'<mesh name="{name}" {where}/>']
            geoms.append(f'<geom class="collision" mesh="{name}"/>')
        if not inline:
            assets += [] if body.copy_of else [f'<mesh name="{shared}" file="{shared}.obj"/>']
            color = row([*_color(body.mesh), 1.0])
            geoms.append(f'<geom class="visual" mesh="{shared}" rgba="{color}"/>')
        quat = row(matrices_to_quats(body.turn[None])[0])
        parts.append(
            f'<body name="{body.stem}" pos="{row(body.position)}" quat="{quat}"><freejoint/>'
            f"{_inertial(body)}{''.join(geoms)}</body>"
        )
    told = [f'<text name="splats:{name}" data={quoteattr(file)}/>' for name, file in splats.items()]
    custom = f"<custom>{''.join(told)}</custom>" if told else ""
    friction = row([config.friction, _SPIN, _ROLL])
    return (
        f'<mujoco model="scene"><compiler angle="radian" meshdir="{MESHES}"/>'
        f'<option timestep="{_STEP}" gravity="0 0 {-GRAVITY}" integrator="implicitfast" '
        'cone="elliptic"/>'
        f'<default><geom condim="6" friction="{friction}"/>'
        f'<default class="collision"><geom type="mesh" group="{_COLLISION}"/></default>'
        f'<default class="visual"><geom type="mesh" group="{_VISUAL}" contype="0" conaffinity="0" '
        f'mass="0"/></default></default>{custom}'
        f"<asset>{''.join(assets)}</asset><worldbody>{''.join(parts)}</worldbody></mujoco>"
    ).replace("><", ">\n<")


def urdf_of(body: Body, friction: float) -> str:
    """URDF of one body: a link with its visual mesh and convex parts."""
    tensor, of = body.properties.inertia, body.properties
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2)}
    entries["izz"] = (2, 2)
    inertia = " ".join(f'{name}="{tensor[at]:.9g}"' for name, at in entries.items())
    shapes = [("visual", f"{body.stem}.obj")]
    shapes += [("collision", part_file(body, k)) for k in range(len(body.parts))]
    drawn = "".join(
        f'<{kind}><geometry><mesh filename="{MESHES}/{file}"/></geometry></{kind}>'
        for kind, file in shapes
    )
    return (
        f"<robot name={quoteattr(body.stem)}><link name={quoteattr(body.stem)}>"
        f'<inertial><origin xyz="{row(of.centre)}"/><mass value="{of.mass:.9g}"/>'
        f"<inertia {inertia}/></inertial>{drawn}"
        f'<contact><lateral_friction value="{friction:.9g}"/></contact></link></robot>'
    ).replace("><", ">\n<")


def static_urdf_of(world: World) -> str:
    """URDF of what stays, in the world's axes: boxes, and the height field as a mesh."""
    shapes = []
    for box in world.static.boxes:
        roll_pitch_yaw = row(Rotation.from_matrix(box.axes).as_euler("xyz"))
        shapes.append(
            f'<origin xyz="{row(box.centre)}" rpy="{roll_pitch_yaw}"/>'
            f'<geometry><box size="{row(2 * box.half)}"/></geometry>'
        )
    if world.static.ground is not None:
        shapes.append(f'<geometry><mesh filename="{MESHES}/{_GROUND}.obj"/></geometry>')
    solid = "".join(f"<collision>{shape}</collision>" for shape in shapes)
    contact = f'<contact><lateral_friction value="{world.config.friction:.9g}"/></contact>'
    return (f'<robot name="static"><link name="static">{solid}{contact}</link></robot>').replace(
        "><", ">\n<"
    )


def row(values: Sequence[float] | AnyArray) -> str:
    """Numbers as XML has them."""
    return " ".join(f"{value:.9g}" for value in np.asarray(values, np.float64).ravel())


def _box(box: Box) -> str:
    axes: DoubleArray = box.axes
    quat = matrices_to_quats(axes[None])[0]
    return f'type="box" pos="{row(box.centre)}" quat="{row(quat)}" size="{row(box.half)}"'


def _ground(of: HeightField) -> tuple[str, str]:
    """The asset of a height field and its geom. The first row of a text is at the highest y."""
    n_rows, n_columns = of.heights.shape
    half = of.cell * (np.array([n_columns, n_rows]) - 1) / 2
    high = max(float(of.heights.max()), of.cell)
    size = row([*half, high, max(half)])
    middle = row(of.corner + np.array([*half, 0.0]))
    values = " ".join(f"{value:.5g}" for value in of.heights[::-1].ravel())
    return (
        f'<hfield name="{_GROUND}" nrow="{n_rows}" ncol="{n_columns}" size="{size}" '
        f'elevation="{values}"/>',
        f'<geom type="hfield" hfield="{_GROUND}" pos="{middle}" group="{_COLLISION}"/>',
    )


def _inertial(body: Body) -> str:
    of = body.properties
    full = of.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return f'<inertial pos="{row(of.centre)}" mass="{of.mass:.9g}" fullinertia="{row(full)}"/>'


def _vertices(mesh: TriangleMesh) -> str:
    return f'vertex="{row(mesh.vertices)}"'


def _color(mesh: TriangleMesh) -> DoubleArray:
    """Mean color (3,), 0..1."""
    if mesh.colors is None:
        return np.full(3, 0.7)
    mean: DoubleArray = mesh.colors.mean(axis=0) / 255
    return mean
