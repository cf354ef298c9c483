"""How the captures of a run are read, and whose markers of theirs are solved."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from grabnet.cli.checks import Positive, in_range, one_of
from grabnet.errors import UserError
from grabnet.mosh.captures import read_capture
from grabnet.mosh.layouts import Layout
from grabnet.mosh.markers import MarkerData


@dataclass(frozen=True)
class Reading:
    """How captures are read: see `read_capture`. prefix: of the subject's labels; the one that fits best when None.

    Raises:
        UserError: a rate out of range; an unknown unit or axis.
    """

    unit: str | None = None
    up: str = "z"
    rate: Positive | None = None
    prefix: str | None = None

    def __post_init__(self):
        in_range(self, "reading.")
        one_of(self, "reading.", unit=(None, "mm", "cm", "m"), up=("x", "y", "z"))

    def read(self, path: Path) -> MarkerData:
        """All markers of a file."""
        return read_capture(path, self.unit, self.up, self.rate)

    def of_subject(self, path: Path, markers: MarkerData, layout: Layout) -> MarkerData:
        """The subject's markers among all of a file.

        Raises:
            UserError: no label has the prefix; several prefixes fit the layout.
        """
        if self.prefix is not None:
            try:
                return markers.under(self.prefix)
            except UserError as error:
                raise UserError(f"{path}: {error}") from None
        shared = {p: len({*markers.under(p).labels} & {*layout.labels}) for p in markers.prefixes}
        best = max(shared, key=shared.get)
        if rivals := [p for p in shared if p != best and shared[p] > 0.5 * shared[best]]:
            fitting = ", ".join(p or "(none)" for p in [best, *rivals])
            raise UserError(
                f"{path}: the labels of {fitting} all fit the layout: say whom to solve by reading.prefix=."
            )
        return markers.under(best)
