"""Food, dishes and drinking vessels."""

from __future__ import annotations

from grabnet.open.objects.primitives import capsule, cylinder, ellipsoid, extruded, lathe, sweep
from grabnet.open.objects.prop import Prop, Region
from grabnet.open.objects.solid import blend


def apple() -> Prop:
    body = lathe(
        [(0, 0.006), (0.010, 0.003), (0.019, 0), (0.029, 0.010), (0.0365, 0.028), (0.0385, 0.045), (0.034, 0.061),
         (0.022, 0.070), (0.012, 0.068), (0.006, 0.062), (0, 0.060)],
        smooth=True,
    )  # fmt: skip
    stem = sweep([(0, 0, 0.058), (0.001, 0, 0.070), (0.006, 0, 0.080)], [0.0022, 0.002, 0.0028])
    leaf = ellipsoid(0.014, 0.007, 0.002).turned("y", -25).at(0.016, 0, 0.079)
    return Prop(body | stem | leaf)


def banana() -> Prop:
    flesh = sweep(
        [(-0.085, 0.032, 0.0165), (-0.078, 0.024, 0.0165), (-0.045, -0.006, 0.0165), (0, -0.018, 0.0165),
         (0.045, -0.006, 0.0165), (0.075, 0.018, 0.0165), (0.083, 0.028, 0.0165)],
        [0.0045, 0.0062, 0.0155, 0.0165, 0.016, 0.010, 0.005],
    )  # fmt: skip
    stalk = sweep([(-0.078, 0.024, 0.0165), (-0.087, 0.036, 0.0165), (-0.090, 0.046, 0.0165)], [0.006, 0.0045, 0.0055])
    return Prop(blend(flesh, stalk, radius=0.006).at(y=-0.008))


def bowl() -> Prop:
    wall = lathe(
        [(0, 0.004), (0.028, 0.004), (0.028, 0), (0.034, 0), (0.036, 0.006), (0.054, 0.018), (0.067, 0.037),
         (0.075, 0.060), (0.071, 0.061), (0.063, 0.040), (0.050, 0.022), (0.034, 0.011), (0, 0.009)],
        smooth=True,
    )  # fmt: skip
    rim = Region("rim", (-0.08, -0.08, 0.025), (0.08, 0.08, 0.07), 0.8)
    return Prop(wall, (rim,), upright=True, edge=0.0022)


def cup() -> Prop:
    wall = lathe(
        [(0, 0.004), (0.024, 0.004), (0.025, 0), (0.029, 0), (0.0385, 0.094), (0.0405, 0.095), (0.0405, 0.099),
         (0.037, 0.099), (0.0345, 0.094), (0.0262, 0.010), (0, 0.010)]
    )  # fmt: skip
    body = Region("body", (-0.045, -0.045, 0.012), (0.045, 0.045, 0.09), 0.9)
    return Prop(wall, (body,), upright=True)


def mug() -> Prop:
    outside = cylinder(0.041, 0.092, rounding=0.003).resting()
    handle = sweep(
        [(0.036, 0, 0.076), (0.055, 0, 0.078), (0.070, 0, 0.066), (0.072, 0, 0.046), (0.062, 0, 0.026),
         (0.036, 0, 0.018)],
        0.0052,
    ).stretched(y=1.25)  # fmt: skip
    hollow = cylinder(0.0372, 0.100, rounding=0.003).at(z=0.0055 + 0.050)
    grip = Region("handle", (0.043, -0.02, 0), (0.085, 0.02, 0.1), 0.4)
    body = Region("body", (-0.045, -0.045, 0.008), (0.043, 0.045, 0.086), 0.6)
    return Prop(blend(outside, handle, radius=0.008) - hollow, (grip, body), upright=True)


def wineglass() -> Prop:
    glass = lathe(
        [(0, 0), (0.034, 0), (0.035, 0.003), (0.020, 0.006), (0.008, 0.011), (0.0045, 0.020), (0.0042, 0.060),
         (0.0055, 0.078), (0.010, 0.088), (0.024, 0.098), (0.035, 0.115), (0.038, 0.135), (0.036, 0.160),
         (0.0315, 0.190), (0.0279, 0.190), (0.0324, 0.159), (0.0343, 0.135), (0.0315, 0.117), (0.0215, 0.102),
         (0, 0.094)],
        smooth=True,
    )  # fmt: skip
    stem = Region("stem", (-0.02, -0.02, 0.012), (0.02, 0.02, 0.086), 0.5)
    vessel = Region("bowl", (-0.045, -0.045, 0.090), (0.045, 0.045, 0.18), 0.5)
    return Prop(glass, (stem, vessel), upright=True)


def teapot() -> Prop:
    body = lathe(
        [
            (0, 0),
            (0.036, 0),
            (0.040, 0.004),
            (0.055, 0.022),
            (0.060, 0.042),
            (0.054, 0.066),
            (0.036, 0.086),
            (0, 0.090),
        ],
        smooth=True,
    )
    lid = lathe([(0, 0.080), (0.036, 0.085), (0.037, 0.090), (0.026, 0.097), (0.010, 0.101), (0, 0.101)], smooth=True)
    knob = capsule((0, 0, 0.10), (0, 0, 0.105), 0.005) | ellipsoid(0.0105, 0.0105, 0.009).at(z=0.112)
    spout = sweep(
        [(0.045, 0, 0.030), (0.068, 0, 0.040), (0.082, 0, 0.066), (0.098, 0, 0.086)], [0.017, 0.013, 0.0095, 0.0085]
    )
    mouth = sweep([(0.091, 0, 0.077), (0.106, 0, 0.096)], 0.0048, smooth=False)
    handle = sweep(
        [(-0.046, 0, 0.072), (-0.070, 0, 0.082), (-0.094, 0, 0.072), (-0.094, 0, 0.046), (-0.076, 0, 0.026),
         (-0.052, 0, 0.024)],
        0.0062,
    )  # fmt: skip
    solid = blend(blend(body, spout, handle, radius=0.010), lid, radius=0.002) | knob
    grip = Region("handle", (-0.11, -0.02, 0.01), (-0.062, 0.02, 0.1), 0.85)
    return Prop(solid - mouth, (grip, Region("knob", (-0.02, -0.02, 0.1), (0.02, 0.02, 0.13), 0.1)), upright=True)


def fryingpan() -> Prop:
    pan = lathe(
        [
            (0, 0),
            (0.080, 0),
            (0.086, 0.004),
            (0.100, 0.040),
            (0.0962, 0.0405),
            (0.082, 0.0085),
            (0.078, 0.005),
            (0, 0.005),
        ]
    )
    handle = sweep(
        [(-0.088, 0, 0.026), (-0.115, 0, 0.037), (-0.150, 0, 0.045), (-0.200, 0, 0.050), (-0.250, 0, 0.050),
         (-0.283, 0, 0.047)],
        [0.007, 0.007, 0.0085, 0.0095, 0.010, 0.008],
    ).stretched(y=1.35)  # fmt: skip
    eye = cylinder(0.004, 0.05).at(-0.276, 0, 0.047)
    inside = lathe([(0, 0.005), (0.078, 0.005), (0.082, 0.0085), (0.0962, 0.0405), (0.097, 0.06), (0, 0.06)])
    solid = (blend(pan, handle, radius=0.006) - inside - eye).at(x=0.092)
    return Prop(solid, (Region("handle", (-0.21, -0.03, 0.02), (-0.03, 0.03, 0.08), 0.95),), upright=True, edge=0.0027)


def knife() -> Prop:
    blade = extruded(
        [(-0.005, -0.013), (0.040, -0.0155), (0.080, -0.014), (0.104, -0.006), (0.112, 0.006), (0.112, 0.009),
         (-0.005, 0.011)],
        0.0036,
        rounding=0.0016,
    ).at(z=0.0043)  # fmt: skip
    grip = extruded(
        [(-0.108, -0.012), (-0.100, -0.014), (-0.080, -0.010), (-0.040, -0.0115), (-0.010, -0.012), (0, -0.010),
         (0, 0.010),
         (-0.050, 0.0105), (-0.090, 0.010), (-0.106, 0.007), (-0.111, -0.003)],
        0.015,
        rounding=0.005,
    ).at(z=0.0078)  # fmt: skip
    rivets = [cylinder(0.0032, 0.0165).at(x, -0.001, 0.0085) for x in (-0.085, -0.053, -0.02)]
    solid = blend(blade, grip, radius=0.003) | rivets[0] | rivets[1] | rivets[2]
    return Prop(solid, (Region("handle", (-0.12, -0.03, -0.01), (-0.002, 0.03, 0.03), 0.97),))


def waterbottle() -> Prop:
    body = lathe(
        [(0, 0.003), (0.020, 0.003), (0.026, 0), (0.032, 0.004), (0.034, 0.012), (0.034, 0.048), (0.0315, 0.052),
         (0.0315, 0.055), (0.034, 0.059), (0.034, 0.080), (0.0315, 0.084), (0.0315, 0.087), (0.034, 0.091),
         (0.034, 0.135), (0.031, 0.154), (0.020, 0.173), (0.0135, 0.181), (0.0135, 0.190), (0, 0.190)],
        smooth=True,
    )  # fmt: skip
    ring = cylinder(0.0165, 0.004, rounding=0.0015).at(z=0.184)
    cap = cylinder(0.016, 0.019).at(z=0.199)
    grip = Region("body", (-0.04, -0.04, 0.02), (0.04, 0.04, 0.17), 0.75)
    return Prop(body | ring | cap, (grip, Region("cap", (-0.02, -0.02, 0.18), (0.02, 0.02, 0.22), 0.15)), upright=True)


PROPS = {
    "apple": apple,
    "banana": banana,
    "bowl": bowl,
    "cup": cup,
    "fryingpan": fryingpan,
    "knife": knife,
    "mug": mug,
    "teapot": teapot,
    "waterbottle": waterbottle,
    "wineglass": wineglass,
}
