"""Light baked into the discs: sky, walls' bounce, one warm key light, a lamp, glazed highlights.

Radiance is linear; a film curve and gamma make the color that the splats store. Matt surfaces get
one color; glazed ones a color that depends on the view, fitted by spherical harmonics of degree 2.
What stands between a disc and a light is told by a height map of all discs along its direction.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, LongArray
from gaga_core.color import SH_C0, sh_basis
from tools.demo.objects import BACK, FRONT, LAMP, LEFT, RIGHT, TOP
from tools.demo.shapes import Surface

# Where in a disc its occluder points lie, in steps along u and v.
_SPREAD = np.array([[0, 0], [0.33, 0.33], [-0.33, 0.33], [0.33, -0.33], [-0.33, -0.33]])


def occluders(surface: Surface) -> FloatArray:
    """Points (M, 3) that stand for the discs of all objects (the room is handled by its planes)."""
    chosen = surface.labels > 0
    points, sizes = surface.points[chosen], surface.sizes[chosen]
    along = surface.tangents[chosen] * sizes[:, :1]
    across = np.cross(surface.normals[chosen], surface.tangents[chosen]) * sizes[:, 1:]
    cloud = [points + a * along + b * across for a, b in _SPREAD]
    return np.concatenate(cloud).astype(np.float32)


def lit_share(
    points: FloatArray,  # (N, 3) already lifted off their surface
    cloud: FloatArray,  # (M, 3)
    towards: DoubleArray,  # (3,) unit
    cell: float,
    rng: np.random.Generator,
) -> FloatArray:
    """1 where nothing stands between a point and a far light ``towards`` it, 0 where something
    does; between the two at the fringe of a shadow (four cells are blended)."""
    a, b = _plane(towards)
    axes = np.stack([a, b, towards]).astype(np.float32)
    px, py, pz = axes @ points.T
    qx, qy, qz = axes @ cloud.T
    left, low = qx.min() - cell * (1 + rng.random()), qy.min() - cell * (1 + rng.random())
    width, height = int((qx.max() - left) / cell) + 3, int((qy.max() - low) / cell) + 3
    column = ((qx - np.float32(left)) / np.float32(cell)).astype(np.int32)
    row = ((qy - np.float32(low)) / np.float32(cell)).astype(np.int32)
    nearest = np.full(width * height, -np.inf, np.float32)
    np.maximum.at(nearest, row * width + column, qz)
    x = np.clip((px - np.float32(left)) / np.float32(cell) - 0.5, 0, width - 2)
    y = np.clip((py - np.float32(low)) / np.float32(cell) - 0.5, 0, height - 2)
    i, j = x.astype(np.int32), y.astype(np.int32)
    fx, fy = x - i, y - j
    at = j * width + i
    depth = pz + np.float32(0.6 * cell)
    free = [(nearest[at + k] < depth).astype(np.float32) for k in (0, 1, width, width + 1)]
    top = free[0] * (1 - fx) + free[1] * fx
    bottom = free[2] * (1 - fx) + free[3] * fx
    return (top * (1 - fy) + bottom * fy).astype(np.float32)


def cone(axis: DoubleArray, half_angle: float, n: int) -> DoubleArray:
    """``n`` directions (n, 3) spread evenly over a cone: an area light."""
    k = np.arange(n) + 0.5
    cosine = 1 - k / n * (1 - np.cos(half_angle))
    sine = np.sqrt(1 - cosine**2)
    angle = k * np.pi * (3 - np.sqrt(5))
    a, b = _plane(axis)
    spread = (sine * np.cos(angle))[:, None] * a + (sine * np.sin(angle))[:, None] * b
    return cosine[:, None] * axis + spread


def sphere(n: int) -> DoubleArray:
    """``n`` directions (n, 3) spread evenly over the sphere (Fibonacci lattice)."""
    return cone(np.array([0.0, 0.0, 1.0]), np.pi, n)


def _plane(axis: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    helper = np.array([1.0, 0, 0]) if abs(axis[0]) < 0.8 else np.array([0, 1.0, 0])
    a = np.cross(axis, helper)
    a /= np.linalg.norm(a)
    return a, np.cross(axis, a)


def _unit(x: float, y: float, z: float) -> DoubleArray:
    v = np.array([x, y, z])
    return v / np.linalg.norm(v)


@dataclass(frozen=True)
class Lights:
    """Where light comes from; colors are linear."""

    key_from: tuple[float, float, float] = (0.64, -0.52, 0.72)  # towards the sun, any length
    key_color: tuple[float, float, float] = (3.5, 2.75, 1.85)
    key_cone: float = 0.055  # radians: softness of its shadows
    key_rays: int = 20
    sky_color: tuple[float, float, float] = (0.66, 0.74, 0.86)
    sky_rays: int = 56
    exposure: float = 0.70

    @property
    def key(self) -> DoubleArray:
        """Unit direction towards the sun."""
        return _unit(*self.key_from)


def bake(surface: Surface, lights: Lights, rng: np.random.Generator) -> FloatArray:
    """SH coefficients (N, 9, 3) of every disc's color."""
    cloud = occluders(surface)
    lifted = _lifted(surface, 0.016)
    ambient = np.zeros((len(surface), 3))
    directions = sphere(lights.sky_rays)
    for towards in directions:
        cosine = _cosine(surface, towards)
        free = lit_share(lifted, cloud, towards, 0.012, rng)[:, None]
        bounce = np.array([0.17, 0.135, 0.11])
        seen = free * radiance(surface.points, towards, lights.sky_color) + (1 - free) * bounce
        ambient += (4 / lights.sky_rays) * cosine[:, None] * seen
    sun = np.zeros(len(surface))
    lifted = _lifted(surface, 0.009)
    for towards in cone(lights.key, lights.key_cone, lights.key_rays):
        sun += lit_share(lifted, cloud, towards, 0.005, rng) / lights.key_rays
    sun *= window(surface.points, lights.key)
    direct = (sun * _cosine(surface, lights.key))[:, None] * np.array(lights.key_color)
    albedo = surface.albedo**2.2
    lamp = lamp_light(surface.points, surface.normals)
    glow = surface.finish[:, 2:3]
    diffuse = albedo * (_multibounce(ambient, albedo) + direct + lamp + glow)
    return _fit(surface, diffuse, sun, lights)


def _lifted(surface: Surface, height: float) -> FloatArray:
    """Points (N, 3) so far above their disc that it does not shade itself."""
    return (surface.points + height * surface.normals).astype(np.float32)


def _cosine(surface: Surface, towards: DoubleArray) -> DoubleArray:
    """Lambert's cosine (N,); leaves and cloth also take light from behind."""
    facing = surface.normals @ towards
    soft = surface.finish[:, 3]
    return np.maximum(facing, 0) * (1 - 0.4 * soft) + soft * 0.55 * np.maximum(-facing, 0)


def _multibounce(ambient: DoubleArray, albedo: DoubleArray) -> DoubleArray:
    """Occluded corners of bright surfaces light themselves (after Jimenez et al. 2016)."""
    dark = np.clip(1 - ambient, 0, 1)
    return ambient * (1 + 0.55 * albedo * dark)


def film(radiance: DoubleArray, exposure: float) -> DoubleArray:
    """Gamma-space color of linear radiance: a filmic curve (Narkowicz 2015) and gamma 2.2."""
    x = np.maximum(radiance, 0) * exposure
    curve = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    return np.clip(curve, 0, 1) ** (1 / 2.2)


def _fit(surface: Surface, diffuse: DoubleArray, sun: DoubleArray, lights: Lights) -> FloatArray:
    sh = np.zeros((len(surface), 9, 3), np.float32)
    sh[:, 0] = (film(diffuse, lights.exposure) - 0.5) / SH_C0
    glazed = np.flatnonzero(surface.finish[:, 0] > 0.02)
    views = sphere(40)
    views = views[views[:, 2] > -0.5]  # nobody looks from under the floor
    basis = sh_basis(-views, 2)  # SH is a function of the direction from the eye to the splat
    inverse = np.linalg.solve(basis.T @ basis + 0.2 * np.diag([0.0] + [1.0] * 8), basis.T)
    for part in np.array_split(glazed, max(1, len(glazed) // 8000)):
        light = [diffuse[part] + _gloss(surface, part, sun, view, lights) for view in views]
        colors = film(np.stack(light), lights.exposure)  # (V, n, 3)
        sh[part] = np.einsum("kv,vnc->nkc", inverse, colors - 0.5)
    return sh


def _gloss(
    surface: Surface, part: LongArray, sun: DoubleArray, view: DoubleArray, lights: Lights
) -> DoubleArray:
    """Reflected light (n, 3) towards a viewer in direction ``view``: key light, window, sky."""
    n = surface.normals[part]
    gloss, shine = surface.finish[part, 0:1], surface.finish[part, 1:2]
    facing = np.maximum(n @ view, 0)[:, None]
    mirrored = 2 * facing * n - view
    fresnel = 0.045 + 0.6 * (1 - facing) ** 5
    sky = 0.55 * np.clip(mirrored[:, 2:3] + 0.35, 0, 1) * np.array(lights.sky_color)
    half = lights.key + _anchor(view)
    half /= np.linalg.norm(half)
    spot = np.maximum(n @ half, 0)[:, None] ** (4 * shine)
    key = spot * (0.35 + 0.65 * sun[part, None]) * np.array(lights.key_color) * 1.0
    return gloss * (fresnel * sky * 1.6 + key)


def _anchor(view: DoubleArray) -> DoubleArray:
    """The nearest of six viewers around the scene. A highlight is far smaller than what degree 2
    can tell apart by view: it is drawn sharp for six viewers, and the fit fades between them."""
    azimuth = np.round(np.arctan2(view[1], view[0]) / (np.pi / 3)) * np.pi / 3
    return _unit(float(np.cos(azimuth)), float(np.sin(azimuth)), 0.45)


def radiance(
    points: DoubleArray, towards: DoubleArray, sky: tuple[float, float, float]
) -> DoubleArray:
    """Light (N, 3) that reaches points from a direction when no object stands in it: the sky, or
    what floor and walls throw back."""
    sky_color = np.array(sky) * (0.75 + 0.45 * max(0.0, float(towards @ [0.5, -0.6, 0.6])))
    result = np.tile(sky_color, (len(points), 1))
    if towards[2] < 0:
        result[:] = np.array([0.30, 0.22, 0.15]) * (0.6 + 0.4 * -towards[2])
    wall = np.array([0.46, 0.48, 0.42])
    if towards[1] > 1e-6:
        at = points + ((BACK - points[:, 1]) / towards[1])[:, None] * towards
        hit = (at[:, 2] > 0) & (at[:, 2] < TOP) & (at[:, 0] > LEFT) & (at[:, 0] < RIGHT)
        result[hit] = wall
    if towards[0] < -1e-6:
        at = points + ((LEFT - points[:, 0]) / towards[0])[:, None] * towards
        hit = (at[:, 2] > 0) & (at[:, 2] < TOP) & (at[:, 1] > FRONT) & (at[:, 1] < BACK)
        result[hit] = wall
    return result


def window(points: DoubleArray, key: DoubleArray) -> DoubleArray:
    """Share (N,) of the key light that comes through a tall window of two by four panes.

    The window stands far off; its picture is thrown along ``key`` and blurred by the sun's size.
    """
    across = np.cross(key, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, key)
    a, b = (points - [0.05, 0.0, 0.95]) @ across, (points - [0.05, 0.0, 0.95]) @ up
    soft = 0.025
    frame = _band(a + 0.1, 1.15, soft) * _band(b - 0.1, 1.1, soft)
    bars = np.ones(len(points))
    for at in (0.27, -0.58):
        bars *= 1 - _band(a - at, 0.045, soft)
    for at in (0.32, 0.95, -0.75):
        bars *= 1 - _band(b - at, 0.04, soft)
    return 0.12 + 0.88 * frame * bars


def _band(x: DoubleArray, half: float, soft: float) -> DoubleArray:
    """1 where |x| < half, 0 outside, with a soft rim."""
    t = np.clip((half - np.abs(x)) / (2 * soft) + 0.5, 0, 1)
    return t * t * (3 - 2 * t)


def lamp_light(points: DoubleArray, normals: DoubleArray) -> DoubleArray:
    """Light (N, 3) of the table lamp: warm, falling off with distance."""
    way = LAMP - points
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    facing = np.maximum((normals * way).sum(axis=1, keepdims=True) / distance, 0)
    return 0.055 * facing / (distance**2 + 0.02) * np.array([1.0, 0.72, 0.40])
