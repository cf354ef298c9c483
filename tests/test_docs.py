"""Citations and links: what code, configs and documents point at exists, and says what the code does."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from grabnet.open.grasps.energy import EnergyConfig

ROOT = Path(__file__).parents[1]
SOURCES = [
    path
    for folder in ("train.py", "grabnet", "scripts", "hydra_plugins", "configs", "tests")
    for path in (ROOT / folder, *sorted((ROOT / folder).rglob("*")))
    if path.suffix in (".py", ".yaml") and path != Path(__file__)
]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "assets").glob("*/README.md"))]
REFERENCE = ROOT / "docs/reference.md"
# Of the paper (ECCV 2020) and its supplement.
PAPER = {
    *("1", "2", "3", "3.1", "3.2", "3.3", "3.4", "3.5", "4", "5"),
    *(f"S.{k}" for k in range(1, 14)),
    *(f"S.9.{k}" for k in range(1, 6)),
}

_SECTION = r"(?:S\.)?\d+(?:\.\d+)*"
_PAPER_CITATION = re.compile(rf"\b[Pp]aper,?[\s(]+({_SECTION}(?:(?:,|\s+and)\s+{_SECTION})*)|(S\.\d+(?:\.\d+)*)")
_REF_CITATION = re.compile(r"\bref\.\s*(?:#\s*)?(\d+(?:(?:,|\s+and)\s+(?:#\s*)?\d+)*)")


def cited_sections(text: str) -> list[str]:
    """Sections of the paper that a text cites: "paper 3.3, S.7", "paper (S.9.1)", "S.9.3"."""
    return [section for match in _PAPER_CITATION.finditer(text) for section in re.findall(_SECTION, match[0])]


def cited_parts(text: str) -> list[int]:
    """Parts of the reference that a text cites: "ref. 4", "ref. 8, 9"."""
    return [int(part) for match in _REF_CITATION.finditer(text) for part in re.findall(r"\d+", match[1])]


def headings(text: str) -> dict[str, str]:
    """Headings of a document by the anchor that links to them name."""
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-"): title for title in titles}


def parts() -> list[int]:
    return [int(n) for n in re.findall(r"^## (\d+)\. ", REFERENCE.read_text(), re.MULTILINE)]


def test_citations_are_found_where_they_are():
    assert cited_sections("x (paper 3.3, S.7; ref. 4)") == ["3.3", "S.7"]
    assert cited_sections("the paper (S.9.1)\npaper 5.1") == ["S.9.1", "5.1"] and "5.1" not in PAPER
    assert cited_parts("(ref. 8,\n9). (ref. 4: 4.5 mm) ref. 2 and 3; in preference 7") == [8, 9, 4, 2, 3]


def test_every_cited_part_of_the_reference_exists():
    known = parts()
    assert known == list(range(1, len(known) + 1))
    cited = {path: cited_parts(path.read_text()) for path in SOURCES}
    assert {str(p.relative_to(ROOT)): set(c) - set(known) for p, c in cited.items() if set(c) - set(known)} == {}
    assert {1, 3, 7, 9, 14} <= {part for numbers in cited.values() for part in numbers}


def test_every_cited_section_of_the_paper_exists():
    wrong = {}
    for path in [*SOURCES, *DOCUMENTS]:
        if unknown := set(cited_sections(path.read_text())) - PAPER:
            wrong[str(path.relative_to(ROOT))] = unknown
    assert wrong == {}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document):
    text = document.read_text()
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (document.parent / path).resolve() if path else document
        assert file.exists(), target
        assert not anchor or anchor in headings(file.read_text()), target


def test_the_reference_has_the_energys_weights():
    """Part 15 and the code's defaults are the same."""
    part = REFERENCE.read_text().split("\n## 15. ")[1]
    written = {name: float(value) for name, value in re.findall(r"^\| `(\w+)` \| ([\d.]+) \|", part, re.MULTILINE)}
    config = EnergyConfig()
    assert written == {name: getattr(config, name) for name in written} and len(written) == 13
    lengths_and_shares = {
        "contact_target", "furthest", "skin_slack", "sphere_share", "forearm_gap", "table_gap", "power_opposition",
        "dip_per_pip",
    }  # fmt: skip
    assert set(written) | lengths_and_shares == {field.name for field in fields(EnergyConfig)}
