"""gaga_core: Gaga (TMLR 2026) on numpy and numba, usable without a window.

Conventions, project-wide
-------------------------
Letters   N splats, K chosen splats, V views, H x W pixels, M masks of a view, G groups, D identity
          channels, S spherical-harmonics coefficients per color channel.
Axes      OpenCV: x right, y down, z forward, in the camera; the world is the scene's own frame.
Frames    are in the names: ``cam_from_world`` maps world points into the camera.
Pixels    column u, row v; the centre of the first pixel is (0.5, 0.5).
Rotation  quaternions wxyz; radians everywhere but in texts for people.
Lengths   scene units (COLMAP's scale is arbitrary: never metres).
Labels    int32; 0 = none, groups are 1..G. In a memory bank -1 marks a free Gaussian.
Color     0..1, gamma space: splats are blended as they were trained.
"""

__version__ = "0.1.0"
