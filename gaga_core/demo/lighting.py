"""Light baked into the discs: sky, walls' bounce, one warm key light, a lamp, glazed highlights.

Radiance is linear; a film curve and gamma make the color that the splats store. Matt surfaces get
one color; glazed ones a color that depends on the view, fitted by spherical harmonics of degree 2.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, LongArray
from gaga_core.color import SH_C0, sh_basis
from gaga_core.demo import room
from gaga_core.demo.shadow import cone, lit_share, occluders, sphere
from gaga_core.demo.surface import Surface
from gaga_core.progress import Progress, Stage


def _unit(x: float, y: float, z: float) -> DoubleArray:
    v = np.array([x, y, z])
    result: DoubleArray = v / np.linalg.norm(v)
    return result


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


def bake(surface: Surface, lights: Lights, rng: np.random.Generator) -> Stage[FloatArray]:
    """SH coefficients (N, 9, 3) of every disc's color; yields progress ray by ray."""
    cloud = occluders(surface)
    lifted = _lifted(surface, 0.016)
    ambient = np.zeros((len(surface), 3))
    directions = sphere(lights.sky_rays)
    total = lights.sky_rays + lights.key_rays
    for k, towards in enumerate(directions):
        cosine = _cosine(surface, towards)
        free = lit_share(lifted, cloud, towards, 0.012, rng)[:, None]
        bounce = np.array([0.17, 0.135, 0.11])
        seen = free * room.radiance(surface.points, towards, lights.sky_color) + (1 - free) * bounce
        ambient += (4 / lights.sky_rays) * cosine[:, None] * seen
        yield Progress("Light the scene", k + 1, total)
    sun = np.zeros(len(surface))
    lifted = _lifted(surface, 0.009)
    for k, towards in enumerate(cone(lights.key, lights.key_cone, lights.key_rays)):
        sun += lit_share(lifted, cloud, towards, 0.005, rng) / lights.key_rays
        yield Progress("Light the scene", lights.sky_rays + k + 1, total)
    sun *= room.window(surface.points, lights.key)
    direct = (sun * _cosine(surface, lights.key))[:, None] * np.array(lights.key_color)
    albedo = surface.albedo**2.2
    lamp = room.lamp_light(surface.points, surface.normals)
    glow = surface.finish[:, 2:3]
    diffuse = albedo * (_multibounce(ambient, albedo) + direct + lamp + glow)
    return _fit(surface, diffuse, sun, lights)


def _lifted(surface: Surface, height: float) -> FloatArray:
    """Points (N, 3) so far above their disc that it does not shade itself."""
    result: FloatArray = (surface.points + height * surface.normals).astype(np.float32)
    return result


def _cosine(surface: Surface, towards: DoubleArray) -> DoubleArray:
    """Lambert's cosine (N,); leaves and cloth also take light from behind."""
    facing = surface.normals @ towards
    soft = surface.finish[:, 3]
    result: DoubleArray = np.maximum(facing, 0) * (1 - 0.4 * soft) + soft * 0.55 * np.maximum(
        -facing, 0
    )
    return result


def _multibounce(ambient: DoubleArray, albedo: DoubleArray) -> DoubleArray:
    """Occluded corners of bright surfaces light themselves (after Jimenez et al. 2016)."""
    dark = np.clip(1 - ambient, 0, 1)
    result: DoubleArray = ambient * (1 + 0.55 * albedo * dark)
    return result


def film(radiance: DoubleArray, exposure: float) -> DoubleArray:
    """Gamma-space color of linear radiance: a filmic curve (Narkowicz 2015) and gamma 2.2."""
    x = np.maximum(radiance, 0) * exposure
    curve = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    result: DoubleArray = np.clip(curve, 0, 1) ** (1 / 2.2)
    return result


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
    result: DoubleArray = gloss * (fresnel * sky * 1.6 + key)
    return result


def _anchor(view: DoubleArray) -> DoubleArray:
    """The nearest of six viewers around the scene. A highlight is far smaller than what degree 2
    can tell apart by view: it is drawn sharp for six viewers, and the fit fades between them."""
    azimuth = np.round(np.arctan2(view[1], view[0]) / (np.pi / 3)) * np.pi / 3
    return _unit(float(np.cos(azimuth)), float(np.sin(azimuth)), 0.45)
