"""Values out of range are refused in one wording."""

import math
from types import SimpleNamespace

import pytest

from grabnet.cli.checks import at_least, one_of, positive
from grabnet.errors import UserError

CONFIG = SimpleNamespace(n=0, seed=0, threads=None, share=math.nan, hand="x", up=None)


def test_values_in_range_and_omitted_ones_pass():
    at_least(CONFIG, n=0, seed=0, threads=1)
    one_of(CONFIG, hand=("x", "y"), up=(None, "z"))


@pytest.mark.parametrize(
    ("check", "sentence"),
    [
        (lambda: at_least(CONFIG, seed=0, n=1), "n is 0; it must be at least 1."),
        (lambda: at_least(CONFIG, "data.", n=1), "data.n is 0; it must be at least 1."),
        (lambda: at_least(CONFIG, share=0), "share is nan; it must be at least 0."),
        (lambda: one_of(CONFIG, hand=("right", "left")), "hand is 'x'; it can be right, left."),
        (lambda: one_of(CONFIG, "a.", up=("x", "y")), "a.up is None; it can be x, y."),
        (lambda: one_of(CONFIG, hand=("z", None)), "hand is 'x'; it can be z, null."),
    ],
)
def test_others_are_refused_in_one_wording(check, sentence):
    with pytest.raises(UserError) as error:
        check()
    assert str(error.value) == sentence


@pytest.mark.parametrize("value", [0, -1.0, float("nan")])
def test_what_is_not_above_zero_is_refused(value):
    with pytest.raises(UserError, match=r"size is .*; it must be above 0\."):
        positive(SimpleNamespace(size=value), "size")
    positive(SimpleNamespace(size=1e-9), "size")
