"""One subject of the open sequences, and a few recordings made on the spot."""

from __future__ import annotations

import pytest

from grabnet.body.hand import HandModel
from grabnet.body.whole import BodyModel
from grabnet.open.body.subjects import open_subjects
from grabnet.open.grasps.store import load_open_grasps
from grabnet.open.sequences.actor import Actor


@pytest.fixture(scope="package")
def actor() -> Actor:
    body = BodyModel.open()
    return Actor(open_subjects(body, load_open_grasps())[6], body, HandModel.open())
