"""A folder is continued with the settings that it was started with, and with no others."""

import pytest

from grabnet.errors import UserError
from grabnet.io.recipes import claim

RECIPE = {"format": 1, "filter": {"min_lift": 0.005, "parts": (1, 2)}}


def test_the_same_recipe_passes_again_and_the_file_stays_as_it_was(tmp_path):
    for _ in range(2):
        claim(tmp_path / "recipe.json", RECIPE, "delete it")
    before = (tmp_path / "recipe.json").stat().st_mtime_ns
    claim(tmp_path / "recipe.json", RECIPE, "delete it")
    assert (tmp_path / "recipe.json").stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("recipe", "sentence"),
    [
        (RECIPE | {"filter": {"min_lift": 0.01, "parts": (1, 2)}}, "filter.min_lift=0.005, now it is 0.01"),
        (RECIPE | {"format": 2}, "format=1, now it is 2"),
        ({"format": 1, "filter": {"min_lift": 0.005}}, "filter.parts=[1, 2], now it is None"),
        (RECIPE | {"seed": 0}, "seed=None, now it is 0"),
    ],
)
def test_another_recipe_is_refused_with_the_value_and_the_remedy(tmp_path, recipe, sentence):
    claim(tmp_path / "recipe.json", RECIPE, "delete it")
    with pytest.raises(UserError) as error:
        claim(tmp_path / "recipe.json", recipe, "delete it")
    assert str(error.value) == f"{tmp_path} was started with {sentence}: delete it."


@pytest.mark.parametrize("content", ["", '{"format": ', "[1]"])
def test_a_damaged_recipe_is_refused(tmp_path, content):
    (tmp_path / "recipe.json").write_text(content)
    with pytest.raises(UserError, match=r"recipe\.json is damaged .*: delete it\."):
        claim(tmp_path / "recipe.json", RECIPE, "delete it")
