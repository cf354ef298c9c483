from hypothesis import given
from hypothesis import strategies as st

from grabnet.data.targets import standing_for_all


@given(near=st.integers(1, 100), far=st.integers(0, 100), more=st.integers(0, 2000))
def test_chosen_samples_stand_for_all(near, far, more):
    n = near + far + (more if far else 0)
    places, shares = standing_for_all(n, near, far)
    assert places[:near].tolist() == list(range(near)) and abs(shares[:near] * n - 1).max() < 1e-5
    assert (places.diff() > 0).all() and places[-1] < n
    assert abs(shares.sum() - 1) < 1e-5
    parts = (shares[near:] * n).round()
    assert not far or parts.max() - parts.min() <= 1
    # Each far one is the middle of its part.
    start = near + parts.cumsum(0) - parts
    assert ((places[near:] - start - (parts - 1) / 2).abs() <= 0.5).all()
