"""What tests of synthesis share with those of grasping."""

from ...grasping.conftest import anatomy, hand, limits, model, templates  # noqa: F401, fixtures
