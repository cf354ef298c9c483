import numpy as np
import pytest

from grabnet.body.hand import OPEN_HANDS
from grabnet.errors import UserError
from grabnet.io.npz import read_npz
from grabnet.open.comparing import TOLERANCE, compare_models

SHIPPED = OPEN_HANDS / "MANO_RIGHT.npz"


@pytest.fixture
def changed(tmp_path):
    def save(**changes):
        np.savez(tmp_path / "model.npz", **read_npz(SHIPPED) | changes)
        return tmp_path / "model.npz"

    return save


def test_small_differences_pass_and_the_largest_is_named(changed):
    model = read_npz(SHIPPED)
    path = changed(v_template=model["v_template"] + np.float32(0.5 * TOLERANCE))
    name, difference = compare_models(path, SHIPPED)
    assert name == "v_template" and difference == pytest.approx(0.5 * TOLERANCE, rel=0.01)


def test_other_models_are_refused(changed):
    model = read_npz(SHIPPED)
    with pytest.raises(UserError, match=r"weights is up to 0\.01"):
        compare_models(changed(weights=model["weights"] + np.float32(0.01)), SHIPPED)
    with pytest.raises(UserError, match="f is up to inf"):
        compare_models(changed(f=model["f"][:, ::-1]), SHIPPED)
    with pytest.raises(UserError, match="v_template"):
        compare_models(changed(v_template=model["v_template"][:-1]), SHIPPED)
    with pytest.raises(UserError, match="dressed"):
        compare_models(changed(dressed=np.ones(1)), SHIPPED)
