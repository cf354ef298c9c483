"""Values out of range are refused in one wording, whoever gives them."""

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Annotated

import pytest

from grabnet.cli.checks import Betas, Count, Distance, Filled, Name, Positive, Seed, Share, in_range, one_of
from grabnet.errors import UserError


@dataclass
class Values:
    n: Count = 1
    seed: Seed = 0
    threads: Count | None = None
    share: Share = 0.5
    size: Positive = 1e-9
    distance: Distance = 0.1
    betas: Betas | None = None
    name: Name = "x"
    files: Name | Annotated[list[Name], Filled()] = "x"


@pytest.mark.parametrize("good", [{}, {"seed": 2**32 - 1}, {"share": 0}, {"betas": [-10, 10.0]}, {"files": ["a", "b"]}])
def test_values_in_range_and_omitted_ones_pass(good):
    in_range(Values(**good))


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("n", 0, "n is 0; it must be at least 1."),
        ("n", 10**9, "n is 1000000000; it must be at most 1000000."),
        ("n", 10**400, f"n is {10**400}; it must be at most 1000000."),
        ("seed", -1, "seed is -1; it must be at least 0."),
        ("seed", 2**32, "seed is 4294967296; it must be at most 4294967295."),
        ("threads", 0, "threads is 0; it must be at least 1."),
        ("share", 2, "share is 2; it must be at most 1."),
        ("share", math.nan, "share is nan; it must be a finite number."),
        ("size", math.inf, "size is inf; it must be a finite number."),
        ("size", 0, "size is 0; it must be above 0."),
        ("size", -1.0, "size is -1.0; it must be above 0."),
        ("distance", 4.5, "distance is 4.5; it must be at most 0.1."),
        ("betas", [0.0, math.nan], "betas is nan; it must be a finite number."),
        ("betas", [1e38], "betas is 1e+38; it must be at most 10."),
        ("betas", [], "betas is []; it must not be empty."),
        ("name", "", "name is ''; it must not be empty."),
        ("files", [], "files is []; it must not be empty."),
        ("files", ["a", ""], "files is ''; it must not be empty."),
    ],
)
def test_others_are_refused_in_one_wording(name, value, sentence):
    with pytest.raises(UserError) as error:
        in_range(Values(**{name: value}))
    assert str(error.value) == sentence


def test_the_place_and_the_function_are_named():
    def function(share: Share) -> None: ...

    with pytest.raises(UserError, match=r"^data\.share is 3; it must be at most 1\.$"):
        in_range(SimpleNamespace(share=3), "data.", of=function)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"hand": ("right", "left")}, "hand is 'x'; it can be right, left."),
        ({"hand": ("z", None)}, "hand is 'x'; it can be z, null."),
    ],
)
def test_words_that_are_no_option_are_refused(options, sentence):
    one_of(SimpleNamespace(hand="x", up=None), hand=("x", "y"), up=(None, "z"))
    with pytest.raises(UserError) as error:
        one_of(SimpleNamespace(hand="x"), **options)
    assert str(error.value) == sentence
