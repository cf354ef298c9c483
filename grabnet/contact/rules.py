"""How contact is annotated where sources leave a choice (ref. 4)."""

from __future__ import annotations

from dataclasses import dataclass

from grabnet.cli.checks import one_of

MEASURED_TO = ("surface", "vertices")
PART_BY = ("skinning", "bone")


@dataclass(frozen=True)
class ContactRules:
    """The values of `configs/shared/contact/`, which explain them.

    Attributes:
        measured_to: "surface" or "vertices".
        part_by: "skinning" or "bone".

    Raises:
        UserError: another value.
    """

    measured_to: str = "surface"
    part_by: str = "skinning"

    def __post_init__(self):
        one_of(self, "contact.", measured_to=MEASURED_TO, part_by=PART_BY)
