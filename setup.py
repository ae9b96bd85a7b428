"""Which packages are installed: gnc_opt, and inside it the problems, to be run and read.

``gnc_opt/shipped`` is no package, so that nothing imports the problems by another name than their own.
"""

from setuptools import find_packages, setup

setup(
    packages=[
        *find_packages(include=["gnc_opt*"]),
        *(f"gnc_opt.shipped.{name}" for name in find_packages(include=["problems*"])),
    ],
    package_dir={"gnc_opt.shipped.problems": "problems"},
)
