"""Which folders make the package; all else about it is in pyproject.toml.

configs/ and assets/ stand beside the code in a checkout and inside the package once it is installed.
"""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["grabnet*"]), "grabnet.configs", "grabnet.assets", "hydra_plugins"],
    package_dir={"grabnet.configs": "configs", "grabnet.assets": "assets"},
)
