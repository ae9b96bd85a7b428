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
lines = [*project["dependencies"], *extras["test"]]
for line in lines:
    requirement = Requirement(line)
    if requirement.name == project["name"]:  # extras of our own
        lines += [needed for extra in sorted(requirement.extras) for needed in extras[extra]]
    else:
        (floor,) = requirement.specifier
        assert floor.operator == ">=", f"{line}: the oldest version is not stated"
        print(f"{requirement.name}=={floor.version}")
