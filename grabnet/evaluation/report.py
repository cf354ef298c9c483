"""stub"""
from __future__ import annotations
from dataclasses import dataclass
from typing import Any
@dataclass(frozen=True, eq=False, kw_only=True)
class Findings:
    rows: Any
    objects: Any
    metrics: Any
    figures: Any
    errors: Any
    surprises: Any
    split: str
    record: Any
def write_report(path, findings, pictures, cache): pass
