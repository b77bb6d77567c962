"""Brute-force float64 rasterizer: what the fast backends are tested against.

No tiles, no bounding boxes, no early end: every splat is evaluated at every pixel, one after the
other, front to back. For small scenes.
"""

from collections.abc import Iterator

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.camera import NEAR, Camera
from gaga_core.color import sh_basis
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.raster.base import ALPHA_MAX, ALPHA_MIN, BLUR, T_MIN, Frame, LabelFrame, PixelWeights
from gaga_core.raster.vote_slots import VoteSlots


class ReferenceRasterizer:
    """Readable float64 implementation of `raster.base.Rasterizer`."""

    name = "reference"

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        *,
        channels: FloatArray | None = None,
        background: DoubleArray | FloatArray | None = None,
    ) -> Frame:
        """Blend SH color, or ``channels`` (N, C), and depth over ``background`` (C,)."""
        if channels is not None:
            check_shape("channels", channels, (len(gaussians), "C"))
        features = sh_color(gaussians, camera) if channels is None else channels.astype(np.float64)
        shape = (camera.height, camera.width)
        image = np.zeros((*shape, features.shape[1]))
        transmittance = np.ones(shape)
        depth_sum, median = np.zeros(shape), np.zeros(shape)
        for i, depth, w in blend(gaussians, camera):
            image += w[..., None] * features[i]
            depth_sum += w * depth
            after = transmittance - w
            median[(transmittance > 0.5) & (after <= 0.5)] = depth
            transmittance = after
        alpha = 1 - transmittance
        expected = np.divide(depth_sum, alpha, out=np.zeros(shape), where=alpha > 0)
        if background is not None:
            image += transmittance[..., None] * np.asarray(background, np.float64)
        return Frame(*(a.astype(np.float32) for a in (image, alpha, expected, median)))

    def weights(
        self, gaussians: Gaussians, camera: Camera, pixels: LongArray, *, w_min: float = 0.0
    ) -> PixelWeights:
        """Blending weights above ``w_min`` of ``pixels`` (P,), flat indices v * width + u."""
        rows: list[list[tuple[int, float]]] = [[] for _ in pixels]
        for i, _, w in blend(gaussians, camera):
            at_pixels = w.ravel()[pixels]
            for p in np.flatnonzero(at_pixels > w_min):
                rows[p].append((i, float(at_pixels[p])))
        entries = [entry for row in rows for entry in row]
        return PixelWeights(
            np.cumsum([0] + [len(row) for row in rows]).astype(np.int64),
            np.array([i for i, _ in entries], np.int32),
            np.array([w for _, w in entries], np.float32),
        )

    def vote(
        self,
        gaussians: Gaussians,
        camera: Camera,
        labels: IntArray,
        histogram: FloatArray | VoteSlots,
    ) -> None:
        """histogram[i, k] += sum of w_i over pixels with label k; negative labels are ignored."""
        counted = labels >= 0
        if isinstance(histogram, VoteSlots):
            present = np.unique(labels[counted])
            for i, _, w in blend(gaussians, camera):
                sums = [w[labels == label].sum() for label in present]
                added = np.array([sums], np.float32)
                histogram.add(np.array([i], np.int32), present, added)
            return
        for i, _, w in blend(gaussians, camera):
            histogram[i] += np.bincount(
                labels[counted], weights=w[counted], minlength=histogram.shape[1]
            ).astype(np.float32)

    def label_splat(self, gaussians: Gaussians, camera: Camera, labels: IntArray) -> LabelFrame:
        """Argmax over ``labels`` (N,) of summed weights, through one plane a label."""
        values = np.unique(np.append(labels, 0))
        total = np.zeros((len(values), camera.height, camera.width))
        for i, _, w in blend(gaussians, camera):
            total[np.searchsorted(values, labels[i])] += w
        best = total.argmax(axis=0)
        return LabelFrame(values[best].astype(np.int32), total.max(axis=0).astype(np.float32))


def blend(gaussians: Gaussians, camera: Camera) -> Iterator[tuple[int, float, DoubleArray]]:
    """For each Gaussian in view, front to back: index, depth and blending weights (H, W)."""
    index, depths, centres, covariances = project(gaussians, camera)
    opacities = 1 / (1 + np.exp(-gaussians.logit_opacities[index].astype(np.float64)))
    if gaussians.is_antialiased:
        plain = np.linalg.det(covariances - BLUR * np.eye(2))
        opacities *= np.sqrt(np.maximum(0, plain) / np.linalg.det(covariances))
    u = np.arange(camera.width) + 0.5
    v = np.arange(camera.height)[:, None] + 0.5
    transmittance = np.ones((camera.height, camera.width))
    is_open = np.ones((camera.height, camera.width), bool)
    # Depth as float32, ties by index: the order that every backend draws in.
    for k in np.argsort(depths.astype(np.float32), kind="stable"):
        dx, dy = u - centres[k, 0], v - centres[k, 1]
        a, b, c = np.linalg.inv(covariances[k])[[0, 0, 1], [0, 1, 1]]
        alpha = np.minimum(
            ALPHA_MAX, opacities[k] * np.exp(-0.5 * (a * dx**2 + c * dy**2) - b * dx * dy)
        )
        alpha[alpha < ALPHA_MIN] = 0
        after = transmittance * (1 - alpha)
        is_open &= after >= T_MIN
        w = np.where(is_open, alpha * transmittance, 0)
        transmittance = np.where(is_open, after, transmittance)
        yield int(index[k]), float(depths[k]), w


def project(
    gaussians: Gaussians, camera: Camera
) -> tuple[LongArray, DoubleArray, DoubleArray, DoubleArray]:
    """EWA projection (Zwicker 2001; Kerbl 2023) of the n Gaussians that are drawn.

    Returns index (n,), camera depth (n,), centre (n, 2) and covariance (n, 2, 2) in pixels. Left
    out: centres nearer than NEAR, quaternions of no length, anything not finite.
    """
    means = gaussians.means.astype(np.float64)
    with np.errstate(all="ignore"):
        p_cam = means @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]
        scales = np.exp(gaussians.log_scales.astype(np.float64))
        lengths = np.linalg.norm(gaussians.quats.astype(np.float64), axis=1)
        keep = p_cam[:, 2] >= NEAR
        keep &= np.isfinite(p_cam).all(axis=1) & np.isfinite(scales).all(axis=1)
        keep &= np.isfinite(lengths) & (lengths > 0) & ~np.isnan(gaussians.logit_opacities)
    index = np.flatnonzero(keep)
    p_cam, scales = p_cam[index], scales[index]
    axes = quats_to_matrices(gaussians.quats[index]) * scales[:, None, :]
    depth = p_cam[:, 2]
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    limit = 1.3 * np.array([0.5 * camera.width / fx, 0.5 * camera.height / fy])
    slope = p_cam[:, :2] / depth[:, None]
    clamped = np.clip(slope, -limit, limit)
    J = np.zeros((len(index), 2, 3))
    J[:, 0, 0], J[:, 0, 2] = fx / depth, -fx * clamped[:, 0] / depth
    J[:, 1, 1], J[:, 1, 2] = fy / depth, -fy * clamped[:, 1] / depth
    M = J @ camera.cam_from_world[:3, :3] @ axes
    covariance = M @ M.transpose(0, 2, 1) + BLUR * np.eye(2)
    return index, depth, slope * [fx, fy] + camera.K[:2, 2], covariance


def sh_color(gaussians: Gaussians, camera: Camera) -> DoubleArray:
    """Color max(0, 0.5 + SH) (N, 3) seen from the camera's position."""
    directions = gaussians.means.astype(np.float64) - camera.position
    with np.errstate(all="ignore"):
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        basis = sh_basis(directions, gaussians.sh_degree)
        color = 0.5 + np.einsum("ns,nsc->nc", basis, gaussians.sh.astype(np.float64))
    return np.where(np.isfinite(color), np.maximum(0, color), 0)
