from __future__ import annotations

import pytest

from grabnet.evaluation.hands import HandLabels


@pytest.fixture(scope="session")
def labels(hand) -> HandLabels:
    return HandLabels.of(hand)
