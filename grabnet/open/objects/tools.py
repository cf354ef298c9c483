"""Tools and things of the desk."""

from __future__ import annotations

import numpy as np

from grabnet.open.objects.primitives import (
    box,
    cylinder,
    ellipsoid,
    extruded,
    lathe,
    loft,
    sweep,
    torus,
)
from grabnet.open.objects.prop import Prop, Region
from grabnet.open.objects.solid import Solid, blend, union


def hammer() -> Prop:
    # Lies on its side: handle along x, face and claw along y.
    grip = loft(
        [(-0.190, 0.014, 0.011), (-0.180, 0.0165, 0.0125), (-0.130, 0.0155, 0.0120), (-0.090, 0.0145, 0.0115),
         (-0.080, 0.0120, 0.0095),
         (-0.040, 0.0110, 0.0085), (0.060, 0.0105, 0.0085), (0.088, 0.0105, 0.0085)]
    )  # fmt: skip
    eye = box(0.027, 0.036, 0.0235, rounding=0.004).at(0.073)
    neck = cylinder(0.0095, 0.034).turned("x", 90).at(0.073, -0.028)
    face = cylinder(0.0125, 0.020, rounding=0.003).turned("x", 90).at(0.073, -0.050)
    claw_side = [
        (0.087, 0.010),
        (0.086, 0.030),
        (0.079, 0.048),
        (0.064, 0.064),
        (0.0615, 0.0615),
        (0.069, 0.045),
        (0.068, 0.028),
        (0.059, 0.010),
    ]
    claw = extruded(claw_side, 0.022, rounding=0.0015)
    notch = box(0.1, 0.05, 0.004).at(0.075, 0.062)
    solid = union(
        blend(grip, eye, radius=0.004), blend(eye, neck, radius=0.006), face, blend(eye, claw - notch, radius=0.004)
    )
    return Prop(solid.resting(), (Region("handle", (-0.2, -0.03, -0.01), (0.0, 0.03, 0.04), 0.95),))


def scissors() -> Prop:
    # Two halves, a little open, one above the other at the pivot; in one piece, as printed.
    def half() -> Solid:
        blade = extruded(
            [(-0.012, -0.007), (0.006, -0.0095), (0.050, -0.0085), (0.100, -0.0015), (0.104, 0.001),
             (0.010, 0.0045), (-0.012, 0.006)],
            0.0036,
            rounding=0.0015,
        )  # fmt: skip
        shank = sweep([(-0.006, -0.001, 0), (-0.020, 0.005, 0), (-0.034, 0.010, 0)], [0.0038, 0.0045, 0.0045])
        bow = torus(0.0185, 0.0048).stretched(x=1.3).at(-0.056, 0.0185, 0)
        return blend(blade, shank, bow, radius=0.005).turned("z", -7)

    lower, upper = half().at(z=0.0060), half().turned("x", 180).at(z=0.0086)
    pivot = cylinder(0.0058, 0.0105).at(z=0.0073)
    regions = (Region("bows", (-0.11, -0.06, -0.01), (-0.028, 0.06, 0.03), 0.95),)
    return Prop(union(lower, upper, pivot), regions)


def flashlight() -> Prop:
    turned = lathe(
        [(0, -0.085), (0.0125, -0.085), (0.015, -0.082), (0.015, -0.070), (0.0135, -0.068), (0.0135, 0.030),
         (0.0155, 0.034),
         (0.0165, 0.044), (0.0225, 0.056), (0.0235, 0.060), (0.0235, 0.076), (0.0195, 0.077), (0.0185, 0.070),
         (0.006, 0.062), (0, 0.062)],
        rounding=0.0005,
    )  # fmt: skip
    rings = [torus(0.0132, 0.0016).at(z=z) for z in (-0.055, -0.049, -0.043, -0.037, -0.031, -0.025)]
    body = union(turned, *rings).turned("y", 90)
    button = box(0.014, 0.009, 0.006, rounding=0.002).at(0.012, 0, 0.0140)
    regions = (Region("grip", (-0.09, -0.03, -0.01), (0.035, 0.03, 0.06), 0.95),)
    return Prop(union(body, button).turned("y", -3.4).at(z=0.0204), regions)


def stamp() -> Prop:
    handle = lathe(
        [(0, 0.012), (0.013, 0.012), (0.0095, 0.020), (0.0075, 0.032), (0.0090, 0.044), (0.0140, 0.054),
         (0.0165, 0.064),
         (0.0140, 0.074), (0.0080, 0.0795), (0, 0.081)],
        smooth=True,
    )  # fmt: skip
    block = box(0.060, 0.028, 0.014).at(z=0.010)
    rubber = box(0.056, 0.024, 0.008, rounding=0.001).at(z=0.004)
    regions = (Region("handle", (-0.025, -0.025, 0.02), (0.025, 0.025, 0.09), 0.95),)
    return Prop(union(blend(handle, block, radius=0.003), rubber), regions, upright=True)


def stapler() -> Prop:
    base = box(0.140, 0.034, 0.007, rounding=0.003).at(z=0.0035)
    arm = extruded(
        [(-0.070, 0.014), (-0.064, 0.012), (0.060, 0.029), (0.068, 0.033), (0.069, 0.040), (0.060, 0.047),
         (0.030, 0.050), (-0.020, 0.045),
         (-0.055, 0.037), (-0.069, 0.028)],
        0.032,
        rounding=0.005,
    ).turned("x", 90)  # fmt: skip
    rail = box(0.118, 0.016, 0.010).turned("y", -8.0).at(0.003, 0, 0.021)
    post = box(0.026, 0.026, 0.024, rounding=0.003).at(-0.054, 0, 0.014)
    anvil = box(0.020, 0.014, 0.004, rounding=0.001).at(0.056, 0, 0.008)
    regions = (Region("body", (-0.06, -0.03, 0.0), (0.07, 0.03, 0.06), 0.9),)
    return Prop(union(base, arm, rail, post, anvil), regions, upright=True)


def mouse() -> Prop:
    shell = ellipsoid(0.056, 0.031, 0.036).at(x=-0.004) & box(0.116, 0.064, 0.076, rounding=0.004).at(z=0.038)
    wheel = cylinder(0.0085, 0.006).turned("x", 90).at(0.024, 0, 0.0262)
    groove = box(0.075, 0.0022, 0.006, rounding=0.0005).turned("y", 22).at(0.036, 0, 0.0305)
    seam = box(0.0022, 0.070, 0.030, rounding=0.0005).at(0.004, 0, 0.0465)
    slot = box(0.020, 0.0085, 0.012).at(0.024, 0, 0.033)
    cable = sweep([(0.048, 0, 0.007), (0.060, 0, 0.006), (0.072, 0.004, 0.004), (0.082, 0.012, 0.003)], 0.0026)
    solid = union(shell.cut(groove, 0.0015).cut(seam, 0.0015) - slot, wheel, cable)
    regions = (Region("shell", (-0.06, -0.04, 0), (0.04, 0.04, 0.06), 0.95),)
    return Prop(solid.resting(), regions, upright=True)


def phone() -> Prop:
    body = extruded(_rounded_rectangle(0.146, 0.071, 0.011), 0.0088, rounding=0.003)
    screen = extruded(_rounded_rectangle(0.118, 0.063, 0.003), 0.004, rounding=0.0008).at(0.001, 0, 0.0052)
    home = cylinder(0.0052, 0.004, rounding=0.0008).at(-0.066, 0, 0.0050)
    speaker = box(0.0024, 0.014, 0.004, rounding=0.0008).at(0.0665, 0, 0.0050)
    keys = [box(0.011, 0.004, 0.0032, rounding=0.001).at(x, 0.0352) for x in (0.020, 0.034)]
    solid = union(body.cut(screen, 0.001).cut(home, 0.001).cut(speaker, 0.001), *keys)
    return Prop(solid.resting())


def _rounded_rectangle(x: float, y: float, radius: float) -> list[tuple[float, float]]:
    return [
        (sx * (x / 2 - radius) + radius * np.cos(a), sy * (y / 2 - radius) + radius * np.sin(a))
        for sx, sy, quarter in ((1, 1, 0), (-1, 1, 1), (-1, -1, 2), (1, -1, 3))
        for a in np.linspace(quarter * np.pi / 2, (quarter + 1) * np.pi / 2, 5)
    ]


def gamecontroller() -> Prop:
    horn = sweep([(0.048, 0.012, 0.020), (0.060, -0.012, 0.019), (0.066, -0.040, 0.014)], [0.021, 0.019, 0.0135])
    side = blend(horn, ellipsoid(0.032, 0.028, 0.016).at(0.045, 0.012, 0.020), radius=0.012)
    middle = box(0.090, 0.050, 0.034, rounding=0.010).at(0, 0.010, 0.0155)
    trigger = sweep([(0.034, 0.034, 0.021), (0.050, 0.035, 0.020), (0.062, 0.026, 0.019)], 0.006)
    stick = cylinder(0.0055, 0.014).at(0.021, -0.008, 0.036) | ellipsoid(0.0092, 0.0092, 0.0035).at(
        0.021, -0.008, 0.0455
    )
    right_half = union(blend(side, trigger, radius=0.004), stick)
    body = blend(right_half.mirrored("x"), middle, radius=0.010)
    cross = box(0.022, 0.0072, 0.008).at(-0.047, 0.016, 0.037) | box(0.0072, 0.022, 0.008).at(-0.047, 0.016, 0.037)
    buttons = [
        cylinder(0.0042, 0.008, rounding=0.0015).at(0.047 + x, 0.016 + y, 0.037)
        for x, y in ((0.010, 0), (-0.010, 0), (0, 0.010), (0, -0.010))
    ]
    small = [box(0.008, 0.004, 0.004, rounding=0.0015).at(x, 0.018, 0.0325) for x in (-0.010, 0.010)]
    regions = (
        Region("right grip", (0.035, -0.06, 0), (0.09, 0.03, 0.05), 0.7),
        Region("left grip", (-0.09, -0.06, 0), (-0.035, 0.03, 0.05), 0.2),
    )
    return Prop(union(body, cross, *buttons, *small).at(z=0.0033), regions, upright=True)


def camera() -> Prop:
    body = box(0.125, 0.040, 0.076, rounding=0.005).at(z=0.038)
    grip = box(0.026, 0.030, 0.072, rounding=0.008).at(-0.048, -0.022, 0.040)
    hump = (
        extruded([(-0.026, 0), (0.026, 0), (0.017, 0.018), (-0.017, 0.018)], 0.040, rounding=0.003)
        .turned("x", 90)
        .at(z=0.074)
    )
    lens = lathe(
        [(0, 0), (0.033, 0), (0.033, 0.018), (0.0305, 0.020), (0.0305, 0.024), (0.0325, 0.026), (0.0325, 0.048),
         (0.0285, 0.050),
         (0.0275, 0.044), (0.012, 0.039), (0, 0.038)],
        rounding=0.0005,
    ).turned("x", 90).at(0.010, -0.016, 0.036)  # fmt: skip
    shutter = cylinder(0.0065, 0.008).at(-0.048, -0.020, 0.0755)
    dial = cylinder(0.0095, 0.010).at(0.043, 0, 0.0795)
    eyepiece = box(0.028, 0.010, 0.016).at(0, 0.022, 0.080)
    screen = box(0.066, 0.008, 0.046).at(0.004, 0.0225, 0.036) - box(0.058, 0.004, 0.038, rounding=0.001).at(
        0.004, 0.0275, 0.036
    )
    solid = union(body, blend(body, grip, radius=0.004), hump, lens, shutter, dial, eyepiece, screen)
    regions = (
        Region("grip", (-0.07, -0.045, 0), (-0.030, 0.03, 0.09), 0.7),
        Region("lens", (-0.025, -0.075, 0), (0.05, -0.022, 0.075), 0.15),
    )
    return Prop(solid.at(z=0.0005), regions, upright=True)


def binoculars() -> Prop:
    # As on a table: barrels along y, eyepieces towards the user at −y.
    barrel = lathe(
        [(0, -0.058), (0.0155, -0.058), (0.0175, -0.056), (0.0175, -0.042), (0.0135, -0.039), (0.0135, -0.028),
         (0.0205, -0.022),
         (0.0215, 0.010), (0.0255, 0.040), (0.0265, 0.046), (0.0265, 0.064), (0.0230, 0.065), (0.0225, 0.060),
         (0, 0.058)],
        rounding=0.0005,
    ).turned("x", -90)  # fmt: skip
    eye = cylinder(0.0115, 0.010).turned("x", 90).at(y=-0.0585)
    side = barrel.cut(eye).at(x=0.033, z=0.027)
    hinge = cylinder(0.0085, 0.070).turned("x", 90).at(0, 0.002, 0.031)
    bridges = [box(0.040, 0.016, 0.014, rounding=0.003).at(0, y, 0.029) for y in (-0.016, 0.026)]
    wheel = cylinder(0.0115, 0.016).turned("x", 90).at(0, 0.005, 0.036)
    # Tilted so that the narrow eyepieces touch the table as well.
    solid = union(side.mirrored("x"), hinge, *bridges, wheel).turned("x", 4.9)
    regions = (
        Region("right barrel", (0.012, -0.06, 0), (0.065, 0.07, 0.06), 0.5),
        Region("left barrel", (-0.065, -0.06, 0), (-0.012, 0.07, 0.06), 0.2),
    )
    return Prop(solid.at(z=-0.004), regions, upright=True)


PROPS = {
    "binoculars": binoculars,
    "camera": camera,
    "flashlight": flashlight,
    "gamecontroller": gamecontroller,
    "hammer": hammer,
    "mouse": mouse,
    "phone": phone,
    "scissors": scissors,
    "stamp": stamp,
    "stapler": stapler,
}
