"""Toys, animals, vehicles, instruments, and a hand."""

from __future__ import annotations

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


def airplane() -> Prop:
    fuselage = loft(
        [(-0.090, 0.003, 0.003), (-0.080, 0.006, 0.007), (-0.040, 0.012, 0.013), (0.010, 0.0165, 0.0165),
         (0.060, 0.0155, 0.0155),
         (0.078, 0.0110, 0.0110), (0.087, 0.003, 0.003)]
    ).at(z=0.032)  # fmt: skip
    wing = extruded([(0.028, 0), (0.010, 0.092), (-0.008, 0.092), (-0.012, 0)], 0.005, rounding=0.002).at(z=0.026)
    tailplane = extruded([(-0.066, 0), (-0.080, 0.034), (-0.092, 0.034), (-0.090, 0)], 0.0042, rounding=0.0018).at(
        z=0.036
    )
    fin = extruded(
        [(-0.060, 0.034), (-0.080, 0.069), (-0.094, 0.069), (-0.091, 0.034)], 0.0042, rounding=0.0018
    ).turned("x", 90)
    engine = loft(
        [(-0.010, 0.005, 0.005), (0.004, 0.0085, 0.0085), (0.030, 0.0085, 0.0085), (0.036, 0.0065, 0.0065)]
    ).at(0.004, 0.042, 0.0185)
    cabin = ellipsoid(0.018, 0.010, 0.010).at(0.056, 0, 0.042)
    gear = capsule((-0.005, 0.014, 0.024), (-0.005, 0.017, 0.007), 0.0028)
    wheel = cylinder(0.0065, 0.0060).turned("x", 90).at(-0.005, 0.018, 0.0065)
    nose_gear = capsule((0.066, 0, 0.024), (0.066, 0, 0.006), 0.0028) | cylinder(0.0065, 0.0056).turned("x", 90).at(
        0.066, 0, 0.0065
    )
    side = union(wing, tailplane, engine, gear, wheel)
    solid = union(
        blend(fuselage, cabin, radius=0.006), blend(fuselage, side.mirrored("y"), radius=0.004), fin, nose_gear
    )
    return Prop(solid, (Region("fuselage", (-0.07, -0.025, 0.012), (0.09, 0.025, 0.06), 0.8),), upright=True)


def train() -> Prop:
    chassis = box(0.120, 0.040, 0.010).at(0, 0, 0.019)
    boiler = cylinder(0.0195, 0.078, rounding=0.003).turned("y", 90).at(0.020, 0, 0.042)
    bands = [torus(0.0192, 0.0022).turned("y", 90).at(x, 0, 0.042) for x in (0.000, 0.024, 0.048)]
    cab = box(0.042, 0.044, 0.052).at(-0.039, 0, 0.048)
    windows = box(0.022, 0.060, 0.018).at(-0.039, 0, 0.058)
    roof = box(0.054, 0.052, 0.006, rounding=0.0028).at(-0.039, 0, 0.0765)
    chimney = lathe([(0, 0.055), (0.0065, 0.055), (0.0065, 0.074), (0.0105, 0.082), (0.0105, 0.085), (0, 0.085)]).at(
        x=0.046
    )
    flue = cylinder(0.0062, 0.02).at(0.046, 0, 0.092)
    dome = capsule((0.018, 0, 0.058), (0.018, 0, 0.064), 0.0075)
    wheels = [
        cylinder(r, 0.0085).turned("x", 90).at(x, y, r)
        for x, r in ((-0.042, 0.0155), (-0.006, 0.0155), (0.030, 0.0155))
        for y in (-0.0225, 0.0225)
    ]
    hubs = [sphere(0.0042).at(x, y, 0.0155) for x in (-0.042, -0.006, 0.030) for y in (-0.027, 0.027)]
    catcher = extruded([(0.056, -0.018), (0.075, 0), (0.056, 0.018)], 0.016, rounding=0.003).at(z=0.014)
    solid = union(chassis, boiler, *bands, cab - windows, roof, chimney - flue, dome, *wheels, *hubs, catcher)
    return Prop(solid, (Region("boiler and cab", (-0.07, -0.03, 0.03), (0.065, 0.03, 0.09), 0.9),), upright=True)


def duck() -> Prop:
    body = ellipsoid(0.043, 0.032, 0.026).at(0, 0, 0.029)
    breast = sphere(0.025).at(0.020, 0, 0.033)
    tail = capsule((-0.030, 0, 0.036), (-0.049, 0, 0.054), 0.014, 0.0045)
    head = sphere(0.0225).at(0.025, 0, 0.072)
    bill = blend(
        ellipsoid(0.014, 0.011, 0.0032).turned("y", -12).at(0.050, 0, 0.0695),
        ellipsoid(0.012, 0.009, 0.003).turned("y", 10).at(0.048, 0, 0.0645),
        radius=0.002,
    )
    wing = blend(
        ellipsoid(0.022, 0.006, 0.013).turned("y", 15).at(-0.008, 0.0295, 0.035),
        capsule((-0.020, 0.030, 0.041), (-0.034, 0.028, 0.050), 0.007, 0.003),
        radius=0.004,
    )
    eye = sphere(0.0034).at(0.0375, 0.0150, 0.0800)
    solid = union(blend(body, breast, tail, head, radius=0.014), bill, (wing | eye).mirrored("y"))
    base = box(0.2, 0.2, 0.2).at(z=0.1045)
    return Prop((solid & base).resting(), upright=True)


def elephant() -> Prop:
    body = ellipsoid(0.046, 0.031, 0.032).at(-0.008, 0, 0.056)
    head = ellipsoid(0.025, 0.022, 0.026).at(0.044, 0, 0.074)
    legs = [capsule((x, y, 0.045), (x, y, 0.012), 0.0135, 0.0125) for x in (-0.034, 0.022) for y in (-0.018, 0.018)]
    trunk = sweep(
        [
            (0.058, 0, 0.070),
            (0.075, 0, 0.056),
            (0.081, 0, 0.036),
            (0.087, 0, 0.020),
            (0.098, 0, 0.018),
            (0.105, 0, 0.026),
        ],
        [0.014, 0.011, 0.0088, 0.0072, 0.0062, 0.0056],
    )
    tail = sweep([(-0.050, 0, 0.064), (-0.060, 0, 0.052), (-0.061, 0, 0.036)], [0.0036, 0.0028, 0.0038])
    ear = ellipsoid(0.020, 0.0042, 0.026).turned("z", -38).turned("x", -8).at(0.030, 0.030, 0.076)
    tusk = sweep([(0.058, 0.013, 0.060), (0.072, 0.015, 0.050), (0.083, 0.014, 0.051)], [0.0042, 0.0036, 0.0024])
    eye = sphere(0.0032).at(0.0625, 0.0135, 0.0835)
    torso = blend(body, head, *legs, trunk, radius=0.012)
    solid = blend(torso, ear.mirrored("y"), tail, radius=0.004) | (tusk | eye).mirrored("y")
    flat = box(0.3, 0.2, 0.2).at(z=0.1015)
    return Prop(
        (solid & flat).resting(), (Region("body", (-0.06, -0.05, 0.03), (0.03, 0.05, 0.1), 0.85),), upright=True
    )


def piggybank() -> Prop:
    body = ellipsoid(0.052, 0.040, 0.038).at(0, 0, 0.052)
    snout = cylinder(0.0155, 0.024, rounding=0.004).turned("y", 90).at(0.056, 0, 0.056)
    nostrils = [capsule((0.060, y, 0.057), (0.080, y, 0.057), 0.0030) for y in (-0.0055, 0.0055)]
    legs = [capsule((x, y, 0.040), (x, y, 0.009), 0.0115, 0.0105) for x in (-0.026, 0.026) for y in (-0.020, 0.020)]
    ear = ellipsoid(0.006, 0.0105, 0.0150).turned("x", -28).at(0.032, 0.024, 0.089)
    tail = sweep(
        [
            (-0.050, 0, 0.058),
            (-0.058, 0.004, 0.063),
            (-0.062, -0.004, 0.068),
            (-0.066, -0.002, 0.061),
            (-0.066, 0.005, 0.066),
        ],
        0.0028,
    )
    slot = box(0.030, 0.0045, 0.030, rounding=0.0015).at(0, 0, 0.094)
    eye = sphere(0.0034).at(0.0440, 0.0185, 0.0685)
    torso = blend(body, snout, *legs, radius=0.008) - slot
    solid = union(
        blend(torso, ear.mirrored("y"), radius=0.004).cut(nostrils[0], 0.0015).cut(nostrils[1], 0.0015),
        tail,
        eye.mirrored("y"),
    )
    flat = box(0.3, 0.2, 0.2).at(z=0.1012)
    return Prop(
        (solid & flat).resting(), (Region("body", (-0.06, -0.05, 0.02), (0.045, 0.05, 0.1), 0.9),), upright=True
    )


def stanfordbunny() -> Prop:
    """A sitting rabbit made of ellipsoids: ours, in the place of the scanned one."""
    haunch = ellipsoid(0.036, 0.034, 0.034).at(-0.016, 0, 0.036)
    chest = ellipsoid(0.026, 0.025, 0.032).at(0.016, 0, 0.044)
    head = ellipsoid(0.024, 0.0185, 0.0185).turned("y", 12).at(0.036, 0, 0.084)
    cheek = ellipsoid(0.012, 0.0155, 0.011).at(0.046, 0, 0.079)
    thigh = ellipsoid(0.024, 0.011, 0.022).at(-0.014, 0.028, 0.026)
    hind_foot = ellipsoid(0.022, 0.008, 0.0075).at(0.004, 0.030, 0.0075)
    fore_leg = capsule((0.030, 0.013, 0.034), (0.038, 0.013, 0.009), 0.010, 0.0085)
    ear = sweep(
        [(0.026, 0.008, 0.096), (0.016, 0.013, 0.118), (0.004, 0.017, 0.139), (-0.004, 0.019, 0.148)],
        [0.006, 0.0085, 0.007, 0.004],
    )
    tail = sphere(0.0125).at(-0.053, 0, 0.026)
    eye = sphere(0.0032).at(0.0475, 0.0155, 0.0905)
    sides = blend(thigh, hind_foot, fore_leg, ear, radius=0.004).mirrored("y")
    solid = blend(blend(haunch, chest, head, cheek, radius=0.018), sides, tail, radius=0.007) | eye.mirrored("y")
    flat = box(0.3, 0.2, 0.3).at(z=0.1515)
    return Prop(
        (solid & flat).resting(), (Region("body", (-0.06, -0.05, 0.01), (0.06, 0.05, 0.1), 0.75),), upright=True
    )


def hand() -> Prop:
    """An open right hand standing on its wrist, palm towards −y, like a shop window's."""
    wrist = capsule((0, 0, 0), (0, 0, 0.040), 0.024, 0.023).stretched(y=0.72)
    palm = box(0.076, 0.026, 0.078, rounding=0.0125).at(0, 0, 0.080)
    thenar = ellipsoid(0.019, 0.016, 0.032).turned("y", 22).at(0.024, -0.008, 0.064)
    hypothenar = ellipsoid(0.014, 0.013, 0.034).at(-0.025, -0.006, 0.066)
    fingers = [
        sweep(
            [(x, 0, 0.108), (x + lean * 0.5, -0.002, 0.112 + 0.5 * length), (x + lean, -0.010, 0.112 + length)],
            [0.0100, thick, thick - 0.0016],
        )
        for x, lean, length, thick in (
            (0.0290, 0.010, 0.062, 0.0088),  # index
            (0.0098, 0.003, 0.071, 0.0090),
            (-0.0096, -0.004, 0.065, 0.0086),
            (-0.0285, -0.012, 0.049, 0.0076),  # little finger
        )
    ]
    thumb = sweep([(0.026, -0.006, 0.062), (0.049, -0.010, 0.086), (0.066, -0.014, 0.112)], [0.0140, 0.0110, 0.0085])
    solid = blend(blend(palm, wrist, thenar, hypothenar, radius=0.016), *fingers, thumb, radius=0.007)
    foot = box(0.066, 0.052, 0.012, rounding=0.003)
    solid = (solid & box(0.3, 0.2, 0.3).at(z=0.149)) | foot
    return Prop(solid.resting(), (), upright=True)


def flute() -> Prop:
    tube = lathe(
        [(0, -0.160), (0.0095, -0.160), (0.0115, -0.157), (0.0115, -0.110), (0.0095, -0.106), (0.0095, 0.100),
         (0.0115, 0.104),
         (0.0115, 0.118), (0.0095, 0.122), (0.0115, 0.150), (0.0115, 0.160), (0, 0.160)],
        rounding=0.0005,
    ).turned("y", 90)  # fmt: skip
    bore = cylinder(0.0068, 0.30).turned("y", 90).at(x=0.030)
    holes = [cylinder(0.0036, 0.02).at(x, 0, 0.010) for x in (-0.035, -0.013, 0.009, 0.031, 0.053, 0.075)]
    window = box(0.010, 0.009, 0.02).at(-0.095, 0, 0.012)
    beak = box(0.060, 0.04, 0.02).turned("y", -22).at(-0.168, 0, 0.0125)
    solid = tube.cut(beak) - bore
    for opening in (*holes, window):
        solid = solid.cut(opening, 0.0012)
    return Prop(solid.resting(), (Region("tube", (-0.1, -0.02, -0.01), (0.13, 0.02, 0.04), 0.9),))


def table() -> Prop:
    """A toy table."""
    top = box(0.130, 0.085, 0.008).at(z=0.076)
    apron = box(0.108, 0.064, 0.012).at(z=0.067)
    under = box(0.096, 0.052, 0.02).at(z=0.062)
    legs = [
        capsule((x, y, 0.070), (1.06 * x, 1.06 * y, 0.0), 0.0068, 0.0048)
        for x in (-0.052, 0.052)
        for y in (-0.030, 0.030)
    ]
    flat = box(0.3, 0.2, 0.2).at(z=0.1)
    regions = (Region("top", (-0.07, -0.05, 0.06), (0.07, 0.05, 0.09), 0.7),)
    return Prop(union(top, apron - under, *legs) & flat, regions, upright=True)


PROPS = {
    "airplane": airplane,
    "duck": duck,
    "elephant": elephant,
    "flute": flute,
    "hand": hand,
    "piggybank": piggybank,
    "stanfordbunny": stanfordbunny,
    "table": table,
    "train": train,
}
