from tests.preprocess.conftest import grab  # noqa: F401, a fixture
