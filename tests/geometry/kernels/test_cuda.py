"""That the kernels compile for NVIDIA GPUs, which needs none: warp brings the compiler along."""

import importlib
import re
from pathlib import Path

import pytest
import warp as wp

import grabnet

ROOT = Path(grabnet.__file__).parents[1]
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in sorted((ROOT / "grabnet").rglob("*.py"))
    if "@wp.kernel" in path.read_text()
]


@pytest.mark.parametrize("name", MODULES)
def test_kernels_compile_for_cuda(name, tmp_path):
    module = importlib.import_module(name)
    wp.compile_aot_module(module, arch=[80], module_dir=tmp_path, use_ptx=True)
    (ptx,) = tmp_path.glob("*.ptx")
    entries = set(re.findall(r"\.entry (\w+)", ptx.read_text()))
    kernels = {key for key, value in vars(module).items() if isinstance(value, wp.Kernel)}
    assert kernels
    assert all(any(entry.startswith(kernel) for entry in entries) for kernel in kernels)
