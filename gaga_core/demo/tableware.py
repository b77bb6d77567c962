"""Mugs, teapot, bowl, plates, bottle, vase, candle: glazed, turned on a wheel."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.demo.patches import ellipsoid, revolve, tube
from gaga_core.demo.sampling import Discs
from gaga_core.demo.surface import Material, Paint, Part, parts
from gaga_core.demo.textures import Color, fractal, mix, noise, plain, rgb, step

CREAM = rgb("f3ead7")
CLAY = rgb("b5764f")


def glaze(
    outside: Color, inside: Color = CREAM, *, bare: float = -1.0, dots: bool = False
) -> Paint:
    """Glazed outside, lighter inside, bare clay under the height ``bare``."""

    def paint(d: Discs) -> DoubleArray:
        color = np.asarray(outside) * (0.97 + 0.06 * fractal(d.points / 0.03, 2, 4))[:, None]
        if dots:
            angle = np.arctan2(d.points[:, 1], d.points[:, 0]) / (2 * np.pi) * 14
            row = d.points[:, 2] / 0.022
            a = (angle + 0.5 * np.floor(row)) % 1 - 0.5
            speck = 1 - step(np.hypot(a, row % 1 - 0.5), 0.16, 0.26)
            color = mix(color, CREAM, speck)
        color = mix(color, CLAY, 1 - step(d.points[:, 2], bare - 0.001, bare + 0.002))
        rim = d.uv[np.argmax(d.points[:, 2]), 1]  # the wall runs up outside, then down inside
        hidden = d.uv[:, 1] > rim + 0.03
        return np.where(hidden[:, None], np.asarray(inside), color)

    return paint


def mug(color: Color, inside: Color = CREAM) -> list[Part]:
    """A mug 9.5 cm high; its handle points to +x."""
    finish = Material(glaze(color, inside), 0.9, 50.0)
    wall = [
        (0.0, 0.0),
        (0.034, 0.0),
        (0.0415, 0.006),
        (0.043, 0.02),
        (0.043, 0.086),
        (0.0423, 0.0945),
        (0.0400, 0.0970),
        (0.0377, 0.0945),
        (0.037, 0.086),
        (0.0365, 0.02),
        (0.033, 0.012),
        (0.0, 0.011),
    ]
    strap = [
        (0.038, 0, 0.078),
        (0.058, 0, 0.082),
        (0.073, 0, 0.066),
        (0.072, 0, 0.042),
        (0.058, 0, 0.024),
        (0.038, 0, 0.022),
    ]
    handle = Material(glaze(color, color), 0.9, 50.0)
    return [
        *parts([revolve(wall)], finish, 0.0050),
        *parts([tube(strap, [0.0055] * 6, flat=1.5)], handle, 0.0050),
    ]


def tea(radius: float, height: float) -> list[Part]:
    """The surface of a drink."""
    finish = Material(plain(rgb("5a2e14"), mottle=0.04), 0.8, 60.0)
    return parts([revolve([(radius, height), (0.0, height)], smooth=False)], finish, 0.006)[::1]


def teapot(color: Color) -> list[Part]:
    """A round pot; its spout points to +x."""
    finish = Material(glaze(color, color, bare=0.012, dots=True), 1.0, 45.0)
    smooth = Material(glaze(color, color), 1.0, 45.0)
    body = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.06, 0.006),
        (0.088, 0.04),
        (0.094, 0.075),
        (0.078, 0.115),
        (0.052, 0.133),
        (0.046, 0.135),
    ]
    lid = [
        (0.05, 0.133),
        (0.05, 0.138),
        (0.038, 0.147),
        (0.014, 0.153),
        (0.007, 0.157),
        (0.008, 0.163),
        (0.014, 0.170),
        (0.011, 0.178),
        (0.0, 0.180),
    ]
    spout = [(0.07, 0, 0.05), (0.105, 0, 0.062), (0.128, 0, 0.098), (0.150, 0, 0.128)]
    handle = [
        (-0.07, 0, 0.115),
        (-0.105, 0, 0.124),
        (-0.138, 0, 0.104),
        (-0.140, 0, 0.070),
        (-0.118, 0, 0.045),
        (-0.078, 0, 0.042),
    ]
    knob = Material(glaze(rgb("d9a441"), CREAM), 1.0, 45.0)
    return [
        *parts([revolve(body)], finish, 0.0064),
        *parts([revolve(lid)], knob, 0.0050),
        *parts([tube(spout, [0.024, 0.019, 0.012, 0.011])], smooth, 0.0050),
        *parts([tube(handle, [0.0085] * 6, flat=1.4)], smooth, 0.0050),
    ]


def bowl(color: Color) -> list[Part]:
    """A wide footed bowl, 30 cm across."""
    finish = Material(glaze(color, rgb("e8dcc0"), bare=0.006), 0.8, 35.0)
    wall = [
        (0.0, 0.0),
        (0.055, 0.0),
        (0.06, 0.003),
        (0.058, 0.014),
        (0.10, 0.035),
        (0.136, 0.07),
        (0.150, 0.102),
        (0.1465, 0.1065),
        (0.142, 0.103),
        (0.127, 0.077),
        (0.092, 0.047),
        (0.0, 0.032),
    ]
    return parts([revolve(wall)], finish, 0.0074)


def plate(color: Color, rim: Color) -> list[Part]:
    """A plate 19 cm across with a colored rim."""

    def paint(d: Discs) -> DoubleArray:
        radius = np.hypot(d.points[:, 0], d.points[:, 1])
        band = step(radius, 0.086, 0.088) + 0.7 * step(-np.abs(radius - 0.079), -0.0025, -0.001)
        return mix(color, rim, band * (d.normals[:, 2] > 0.2))

    profile = [
        (0.0, 0.0),
        (0.045, 0.0),
        (0.055, 0.003),
        (0.09, 0.016),
        (0.095, 0.019),
        (0.0945, 0.0225),
        (0.09, 0.0225),
        (0.058, 0.0115),
        (0.045, 0.009),
        (0.0, 0.009),
    ]
    return parts([revolve(profile)], Material(paint, 0.8, 45.0), 0.0062)


def bottle(glass: Color) -> list[Part]:
    """A dark oil bottle with a paper label and a cork."""

    def paint(d: Discs) -> DoubleArray:
        z = d.points[:, 2]
        angle = np.arctan2(d.points[:, 1], d.points[:, 0])
        color = np.asarray(glass) * (0.9 + 0.25 * step(z, 0.05, 0.26))[:, None]
        label = step(z, 0.056, 0.058) * (1 - step(z, 0.138, 0.140)) * (np.abs(angle + 1.2) < 1.5)
        leaf = step(-np.hypot((angle + 1.2) * 0.036, (z - 0.108) * 0.9), -0.018, -0.016)
        line = (np.abs(z - 0.075) < 0.003) | (np.abs(z - 0.066) < 0.0015)
        printed = mix(mix(CREAM, rgb("7d8f3c"), leaf), rgb("4c4032"), np.where(line, 0.8, 0.0))
        return mix(color, printed, label)

    body = [
        (0.0, 0.0),
        (0.030, 0.0),
        (0.036, 0.006),
        (0.037, 0.02),
        (0.037, 0.155),
        (0.031, 0.182),
        (0.016, 0.205),
        (0.0135, 0.225),
        (0.0135, 0.262),
        (0.0165, 0.264),
        (0.0165, 0.274),
        (0.0135, 0.276),
    ]
    cork = [(0.0125, 0.274), (0.0125, 0.294), (0.011, 0.296), (0.0, 0.296)]
    return [
        *parts([revolve(body)], Material(paint, 0.9, 60.0), 0.0048),
        *parts([revolve(cork)], Material(plain(rgb("c49a6a"), mottle=0.12, scale=0.006)), 0.0048),
    ]


def vase(color: Color) -> list[Part]:
    """A tall vase with a speckled matt glaze."""

    def paint(d: Discs) -> DoubleArray:
        speck = step(noise(d.points / 0.004, 8), 0.80, 0.9)
        drip = 0.175 + 0.02 * np.sin(5 * np.arctan2(d.points[:, 1], d.points[:, 0]))
        lower = mix(color, rgb("6b5a48"), 0.6 * speck)
        return mix(lower, CREAM, step(d.points[:, 2], drip - 0.004, drip + 0.004))

    wall = [
        (0.0, 0.0),
        (0.04, 0.0),
        (0.048, 0.005),
        (0.066, 0.06),
        (0.066, 0.11),
        (0.045, 0.175),
        (0.034, 0.205),
        (0.040, 0.232),
        (0.0385, 0.2355),
        (0.036, 0.233),
        (0.030, 0.205),
        (0.040, 0.17),
    ]
    return parts([revolve(wall)], Material(paint, 0.45, 18.0), 0.0062)


def candle(wax: Color, height: float) -> list[Part]:
    """A candle burning in a small brass dish."""
    brass = Material(plain(rgb("b98b3e"), mottle=0.05), 1.0, 25.0)
    dish = [
        (0.0, 0.0),
        (0.036, 0.0),
        (0.045, 0.006),
        (0.047, 0.013),
        (0.0455, 0.014),
        (0.043, 0.008),
        (0.024, 0.006),
        (0.024, 0.022),
        (0.021, 0.023),
    ]
    stick = [
        (0.0195, 0.006),
        (0.0195, height - 0.003),
        (0.0175, height),
        (0.010, height - 0.002),
        (0.0, height - 0.004),
    ]
    wick = tube([(0, 0, height - 0.004), (0, 0, height + 0.010)], [0.0014, 0.0012])
    flame = ellipsoid((0.0052, 0.0052, 0.0145), (0, 0, height + 0.016))
    return [
        *parts([revolve(dish)], brass, 0.0042),
        *parts([revolve(stick)], Material(plain(wax, mottle=0.02), 0.25, 12.0, 0.10, 0.7), 0.0048),
        *parts([wick], Material(plain(rgb("3a3029"))), 0.003),
        *parts([flame], Material(plain(rgb("ffd27a")), glow=6.0), 0.0034),
    ]
