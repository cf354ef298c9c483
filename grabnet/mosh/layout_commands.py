"""Layouts placed on a body and drawn: what `grabnet mosh place` and `grabnet mosh draw` do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from grabnet.cli.checks import one_of
from grabnet.errors import UserError
from grabnet.io.shipped import shipped
from grabnet.mosh.layout_page import draw_layout
from grabnet.mosh.layouts import DISTANCES, read_layout, read_mapping, write_layout
from grabnet.mosh.placing import place_layout
from grabnet.mosh.subjects import GENDERS, Subject

_DRAWN = (".png", ".html")  # written beside a layout


@dataclass(frozen=True)
class PlaceConfig:
    """What to place; the values of `configs/mosh/place.yaml`, which explains them.

    Raises:
        UserError: another gender; a name that the picture or the page takes.
    """

    markers: str
    gender: str
    subject: str | None
    models: str | None
    output: str

    def __post_init__(self):
        one_of(self, gender=GENDERS)
        if Path(self.output).suffix.lower() in _DRAWN:
            raise UserError(f"output is '{self.output}'; it cannot end in {' or '.join(_DRAWN)}, as its picture does.")


@dataclass(frozen=True)
class DrawConfig:
    """What to draw; the values of `configs/mosh/draw.yaml`, which explains them.

    Raises:
        UserError: another gender.
    """

    layout: str
    gender: str
    subject: str | None
    models: str | None
    output: str

    def __post_init__(self):
        one_of(self, gender=GENDERS)


def place(config: PlaceConfig) -> int:
    """Place a layout, write and draw it; returns the exit code 0.

    Raises:
        UserError: no such places; a model or template that cannot be read.
    """
    subject, output = Subject("", config.gender, config.subject, config.models), Path(config.output)
    name, places = read_places(config.markers)
    layout, comments = place_layout(name, subject.body, places, subject.v_template)
    write_layout(output, layout, comments)
    reason = draw_layout(output.with_suffix(".png"), layout, subject.body, subject.v_template, comments)
    print(f"{len(layout.markers)} markers are in {output}: edit it, and use it as layout={output}.")
    print(reason or f"{output.with_suffix('.html')} shows them.")
    return 0


def draw(config: DrawConfig) -> int:
    """Draw a layout on the body that it is for; returns the exit code 0.

    Raises:
        UserError: no such layout, or one for another body.
    """
    subject, output = Subject("", config.gender, config.subject, config.models), Path(config.output).with_suffix(".png")
    layout = read_layout(config.layout, len(subject.body.v_template), subject.body.faces.numpy())
    reason = draw_layout(output, layout, subject.body, subject.v_template)
    print(reason or f"{output} shows the {len(layout.markers)} markers of {config.layout}.")
    print(f"{output.with_suffix('.html')} lists them.")
    return 0


def read_places(markers: str) -> tuple[str, dict[str, dict[str, str]]]:
    """The name of a set of markers, and of each type of them label → anatomical place.

    Args:
        markers: name of a set that ships, or a `.yaml` file.

    Raises:
        UserError: no such set or file, or not in this form; a label or a place that occurs twice.
    """
    folder = shipped("configs") / "mosh/places"
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    path = folder / f"{markers}.yaml" if markers in known else Path(markers)
    if not path.exists():
        raise UserError(f"markers is '{markers}', which is no file; those that ship are {', '.join(known)}.")
    content = read_mapping(path, "File of places")
    taken: dict[str, str] = {}
    for type_, those in content.items():
        if type_ not in DISTANCES or not isinstance(those, dict):
            raise UserError(f"{path}: '{type_}' must be {', '.join(DISTANCES)}, with label: place below it.")
        for label, place in those.items():
            if not isinstance(place, str):
                raise UserError(f"{path}: the place of {label} is {place!r}; it must be a name.")
            if place in taken:
                raise UserError(f"{path}: {taken[place]} and {label} are both at {place}.")
            taken[place] = label
        content[type_] = {str(label): place for label, place in those.items()}
    if not taken:
        raise UserError(f"{path} has no markers: body, with label: place below it.")
    if len({label for those in content.values() for label in those}) < len(taken):
        raise UserError(f"{path} has a label in two types.")
    return path.stem, content
