"""Print, as constraints for pip, the oldest versions that pyproject.toml allows: every ``>=`` becomes ``==``."""

import sys
from pathlib import Path

from packaging.requirements import Requirement

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # comes with pytest

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
extras = project["optional-dependencies"]
for line in [
    *project["dependencies"],
    *extras["cluster"],
    *extras["control"],
    *extras["data"],
    *extras["test"],
]:
    requirement = Requirement(line)
    if requirement.name != project["name"]:
        (floor,) = requirement.specifier
        assert floor.operator == ">=", f"{line}: the oldest version is not stated"
        print(f"{requirement.name}=={floor.version}")
