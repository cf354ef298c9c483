"""Things for the body and the house: bathroom, glasses, watch, headphones, bulb, knob, clock."""

from __future__ import annotations

import numpy as np

from grabnet.open.objects.primitives import (
    box,
    capsule,
    cylinder,
    ellipsoid,
    extruded,
    lathe,
    loft,
    sphere,
    sweep,
    torus,
)
from grabnet.open.objects.prop import Prop, Region
from grabnet.open.objects.solid import blend, union


def toothbrush() -> Prop:
    handle = loft(
        [(-0.095, 0.0050, 0.0045), (-0.088, 0.0062, 0.0055), (-0.050, 0.0068, 0.0062), (-0.020, 0.0075, 0.0066),
         (0.010, 0.0055, 0.0055), (0.035, 0.0036, 0.0036), (0.065, 0.0036, 0.0034)]
    )  # fmt: skip
    head = box(0.032, 0.013, 0.0055, rounding=0.0025).at(0.078)
    tufts = [
        capsule((x, y, 0.001), (x, y, 0.0115), 0.0022)
        for x in (0.0675, 0.0742, 0.0809, 0.0876)
        for y in (-0.0034, 0.0034)
    ]
    solid = union(blend(handle, head, radius=0.006), *tufts)
    return Prop(solid.at(z=0.0066), (Region("handle", (-0.1, -0.02, -0.01), (0.02, 0.02, 0.03), 0.95),))


def toothpaste() -> Prop:
    # A tube pressed flat towards its crimped end, round at the shoulder.
    tube = loft(
        [(-0.082, 0.0265, 0.0022), (-0.074, 0.0265, 0.0025), (-0.045, 0.0245, 0.0095), (-0.005, 0.0215, 0.0160),
         (0.035, 0.0190, 0.0185), (0.047, 0.0185, 0.0185), (0.054, 0.0120, 0.0120)]
    )  # fmt: skip
    crimp = box(0.010, 0.055, 0.0046, rounding=0.0018).at(-0.081)
    ridges = [
        box(0.022, 0.0024, 0.0024, rounding=0.001).at(0, 0, 0.0113).turned("x", a).at(0.066) for a in range(0, 360, 30)
    ]
    cap = union(cylinder(0.0113, 0.026).turned("y", 90).at(0.067), *ridges)
    solid = union(tube, crimp, cap).turned("y", -4).at(z=0.0166)
    return Prop(solid, (Region("body", (-0.075, -0.04, -0.01), (0.05, 0.04, 0.05), 0.85),))


def eyeglasses() -> Prop:
    rim = torus(0.0235, 0.0021).turned("x", 90).stretched(x=1.1, z=0.92).at(0.034, -0.07, 0.0235)
    lens = cylinder(0.0235, 0.0034, rounding=0.0015).turned("x", 90).stretched(x=1.1, z=0.92).at(0.034, -0.07, 0.0235)
    hinge = box(0.009, 0.007, 0.008, rounding=0.002).at(0.0625, -0.0675, 0.030)
    temple = sweep(
        [(0.064, -0.067, 0.030), (0.066, -0.03, 0.031), (0.066, 0.010, 0.031), (0.066, 0.035, 0.027),
         (0.065, 0.055, 0.014), (0.064, 0.066, 0.003)],
        [0.0024, 0.0024, 0.0024, 0.0027, 0.003, 0.0028],
    )  # fmt: skip
    half = union(rim, lens, hinge, temple)
    bridge = sweep([(-0.012, -0.07, 0.030), (0, -0.071, 0.034), (0.012, -0.07, 0.030)], 0.0023)
    regions = (
        Region("left temple", (-0.08, -0.062, 0), (-0.055, 0.08, 0.05), 0.3),
        Region("right temple", (0.055, -0.062, 0), (0.08, 0.08, 0.05), 0.45),
        Region("frame", (-0.075, -0.085, 0), (0.075, -0.055, 0.06), 0.25),
    )
    return Prop(union(half.mirrored("x"), bridge).resting(), regions, upright=True)


def watch() -> Prop:
    def band_outline(grow: float) -> list[tuple[float, float]]:
        angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        return [((0.031 + grow) * np.cos(a), (0.026 + grow) * np.sin(a)) for a in angles]

    # The band as a closed loop about the x axis, the case on top.
    band = extruded(band_outline(0.002), 0.020, smooth=True).cut(
        extruded(band_outline(-0.002), 0.03, smooth=True), 0.001
    )
    band = band.turned("x", 90).turned("z", 90)
    clasp = box(0.020, 0.026, 0.005).at(z=-0.0272)
    case = cylinder(0.0205, 0.0105, rounding=0.003).at(z=0.0295)
    bezel = torus(0.0178, 0.0022).at(z=0.0350)
    crown = cylinder(0.0034, 0.006, rounding=0.001).turned("y", 90).at(0.0228, 0, 0.0295)
    lugs = box(0.022, 0.046, 0.006).at(z=0.0275)
    solid = union(band, clasp, case, bezel, crown, lugs)
    hands = [
        capsule((0, 0, 0.0345), (0, 0.011, 0.0345), 0.0016),
        capsule((0, 0, 0.0345), (0.008, -0.004, 0.0345), 0.0016),
    ]
    regions = (
        Region("case", (-0.03, -0.03, 0.045), (0.03, 0.03, 0.08), 0.5),
        Region("band", (-0.02, -0.05, 0), (0.02, 0.05, 0.045), 0.5),
    )
    return Prop(union(solid, *hands).resting(), regions)


def headphones() -> Prop:
    angles = np.linspace(0, np.pi, 13)
    arch = [(0.080 * np.cos(a), 0, 0.088 + 0.082 * np.sin(a)) for a in angles]
    band = sweep([(0.081, 0, 0.066), *arch, (-0.081, 0, 0.066)], 0.0042).stretched(y=1.9)
    pad = sweep([(0.032 * np.cos(a), 0, 0.140 + 0.0275 * np.sin(a)) for a in np.linspace(0.35, np.pi - 0.35, 7)], 0.006)
    shell = ellipsoid(0.016, 0.034, 0.040).at(0.080, 0, 0.041) & box(0.05, 0.1, 0.1).at(0.097, 0, 0.045)
    cushion = torus(0.024, 0.0095).turned("y", 90).stretched(z=1.17).at(0.066, 0, 0.041)
    plate = cylinder(0.026, 0.008).turned("y", 90).stretched(z=1.17).at(0.070, 0, 0.041)
    cup = union(shell, cushion, plate)
    regions = (
        Region("band", (-0.09, -0.03, 0.085), (0.09, 0.03, 0.19), 0.6),
        Region("right cup", (0.05, -0.05, 0), (0.11, 0.05, 0.085), 0.2),
        Region("left cup", (-0.11, -0.05, 0), (-0.05, 0.05, 0.085), 0.2),
    )
    return Prop(union(band, blend(band, pad, radius=0.004), cup.mirrored("x")).resting(), regions, upright=True)


def lightbulb() -> Prop:
    glass = lathe(
        [(0, 0.022), (0.0128, 0.022), (0.0135, 0.030), (0.0170, 0.042), (0.0255, 0.056), (0.0300, 0.073),
         (0.0275, 0.089),
         (0.0185, 0.1005), (0.0085, 0.1045), (0, 0.105)],
        smooth=True,
    )  # fmt: skip
    base = lathe([(0, 0), (0.0060, 0), (0.0065, 0.002), (0.0115, 0.005), (0.0120, 0.026), (0, 0.026)])
    angles = np.linspace(0, 6 * np.pi, 73)
    thread = sweep(
        [(0.0118 * np.cos(a), 0.0118 * np.sin(a), 0.0075 + 0.0125 * a / angles[-1]) for a in angles],
        0.0014,
        smooth=False,
    )
    regions = (
        Region("bulb", (-0.04, -0.04, 0.04), (0.04, 0.04, 0.11), 0.85),
        Region("base", (-0.02, -0.02, 0), (0.02, 0.02, 0.03), 0.15),
    )
    return Prop(union(glass, base, thread), regions)


def doorknob() -> Prop:
    # The plate lies on the table, as a knob unscrewed from its door.
    turned = lathe(
        [(0, 0), (0.031, 0), (0.032, 0.003), (0.028, 0.008), (0.015, 0.010), (0.0105, 0.016), (0.0105, 0.024),
         (0.016, 0.031),
         (0.0255, 0.038), (0.0275, 0.047), (0.0245, 0.056), (0.015, 0.0605), (0, 0.062)],
        rounding=0.0005,
        smooth=True,
    )  # fmt: skip
    lock = cylinder(0.0055, 0.004, rounding=0.001).at(z=0.0625) - box(0.0075, 0.0024, 0.01, rounding=0.0005).at(
        z=0.0665
    )
    return Prop(
        union(turned, lock).resting(), (Region("knob", (-0.04, -0.04, 0.026), (0.04, 0.04, 0.08), 0.95),), upright=True
    )


def alarmclock() -> Prop:
    case = cylinder(0.043, 0.036, rounding=0.005).turned("x", 90)
    recess = cylinder(0.036, 0.006).turned("x", 90).at(y=-0.0185)
    hands = [
        capsule((0, -0.0148, 0), (0, -0.0148, 0.024), 0.002),
        capsule((0, -0.0148, 0), (0.014, -0.0148, 0.009), 0.002),
    ]
    hours = [
        sphere(0.0022).at(0.030 * np.sin(a), -0.0155, 0.030 * np.cos(a))
        for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ]
    half_ball = sphere(0.0195) & box(0.06, 0.06, 0.04).at(z=0.021)
    bell = union(half_ball, capsule((0, 0, -0.012), (0, 0, 0.004), 0.004), sphere(0.0042).at(z=0.0205))
    bell = bell.turned("y", 33).at(0.028, 0, 0.047)
    foot = capsule((0.024, 0, -0.036), (0.034, 0, -0.050), 0.0075, 0.0065)
    handle = sweep([(-0.022, 0, 0.062), (-0.012, 0, 0.073), (0.012, 0, 0.073), (0.022, 0, 0.062)], 0.0028)
    hammer = capsule((0, 0, 0.040), (0, 0, 0.056), 0.0026) | sphere(0.0052).at(z=0.057)
    knobs = cylinder(0.008, 0.008).turned("x", 90).at(0.014, 0.021, 0) | cylinder(0.006, 0.008).turned("x", 90).at(
        -0.014, 0.021, 0.004
    )
    solid = union(case - recess, *hands, *hours, (bell | foot).mirrored("x"), handle, hammer, knobs)
    return Prop(solid.resting(), (Region("case", (-0.05, -0.03, 0.012), (0.05, 0.03, 0.1), 0.8),), upright=True)


PROPS = {
    "alarmclock": alarmclock,
    "doorknob": doorknob,
    "eyeglasses": eyeglasses,
    "headphones": headphones,
    "lightbulb": lightbulb,
    "toothbrush": toothbrush,
    "toothpaste": toothpaste,
    "watch": watch,
}
