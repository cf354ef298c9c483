"""Where compiled kernels are kept."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_a_cache_folder_that_is_not_absolute_is_left_alone(tmp_path):
    environment = {k: v for k, v in os.environ.items() if k != "WARP_CACHE_PATH"}
    result = subprocess.run(
        [sys.executable, "-c", "import grabnet.geometry.kernels.launch"],
        cwd=tmp_path,
        env=environment | {"XDG_CACHE_HOME": "", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0 and "kernels are kept in a temporary one" in result.stderr
    assert not list(tmp_path.iterdir())
