"""The statistics, in the order of the report."""

from __future__ import annotations

from grabnet.analysis.statistic import Statistic
from grabnet.analysis.statistics.body_heat import BodyHeat
from grabnet.analysis.statistics.clusters import Clusters
from grabnet.analysis.statistics.content import Content
from grabnet.analysis.statistics.object_heat import ObjectHeat
from grabnet.analysis.statistics.penetration import Penetration
from grabnet.analysis.statistics.shares import ContactShares
from grabnet.analysis.statistics.sizes import SizeEffect, SizeHeat
from grabnet.analysis.statistics.threshold_heat import ThresholdHeat
from grabnet.analysis.statistics.thresholds import Thresholds

STATISTICS: list[type[Statistic]] = [
    Content,
    ContactShares,
    BodyHeat,
    ObjectHeat,
    SizeEffect,
    SizeHeat,
    Penetration,
    Clusters,
    Thresholds,
    ThresholdHeat,
]
