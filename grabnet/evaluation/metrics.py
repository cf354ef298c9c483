"""What a number of the evaluation is: its protocol, unit, definition, which way is better, and where it is shown."""

from __future__ import annotations

from dataclasses import dataclass

# In the place of an object's name: the mean over objects, each weighing the same.
ALL = "all"


@dataclass(frozen=True)
class Section:
    """A part of the report.

    Attributes:
        title: of the section.
        note: sentences below its tables.
    """

    title: str
    note: str = ""


# Shared by protocols of several files; the others are named where they are used.
FIELD = Section(
    "Protocols of the field",
    "Other data, and protocols that differ three- to five-fold in their outcome: rough marks only.",
)
VOLCO = Section(
    "Volume and contact (volco)",
    "Low volume alone often means loose hands: read it beside the contact area. Rows of others are of other objects "
    "and grasps, re-run by the authors of the protocol: rough marks only.",
)
HAND = Section("Posture, novelty, coverage")
FURTHER = Section("Further protocols")


@dataclass(frozen=True)
class Metric:
    """A number of each grasp, or of many together.

    Attributes:
        protocol: first half of its title.
        name: second half.
        unit: "%" for shares: of a grasp these are 0 or 1, or a share.
        about: definition, a sentence.
        better: "lower", "higher", or None where neither is.
        samples: grasps per object that count, the first; all when None.
        section: of the report that shows it.
        headline: whether it is in the first table of the report and in the summary of `tables.tex`.
        distribution: whether the report draws how its values are distributed.
        caption: format of a grasp's value below its picture; empty where it is not shown there.
        mark: words below the pictures of grasps whose value is not 0; empty where there are none.
        part: of the hand that it is about, where `<series>_<part>` is measured of several parts: these are drawn beside
            each other.
        per_grasp: whether values belong to single grasps, in their order.
        of_hand_alone: whether recorded hands are its yardstick wherever they are placed, so that a method of recorded
            hands is expected neither above nor below others.
    """

    protocol: str
    name: str
    unit: str
    about: str
    better: str | None = None
    samples: int | None = None
    section: Section = FURTHER
    headline: bool = False
    distribution: bool = False
    caption: str = ""
    mark: str = ""
    part: str = ""
    per_grasp: bool = True
    of_hand_alone: bool = False

    @property
    def title(self) -> str:
        return f"{self.protocol}/{self.name}"

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def series(self) -> str:
        """Title without the part."""
        return self.title.removesuffix(f"_{self.part}") if self.part else self.title

    @property
    def scale(self) -> float:
        """From stored values to the unit."""
        return 100.0 if self.unit == "%" else 1.0
