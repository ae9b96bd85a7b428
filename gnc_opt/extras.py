"""Packages that are not needed by everyone: the extras of pyproject.toml."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from gnc_opt.errors import GncOptError


def imported(package: str, extra: str) -> Any:
    """Return a package that an extra of gnc_opt brings; raise `GncOptError` that says how to get it."""
    try:
        module = import_module(package)
    except ImportError:
        module = None
    if getattr(module, "__file__", None) is None:  # a mere folder of that name can be imported, too
        raise GncOptError(f"{package} is not installed: pip install 'gnc_opt[{extra}]'.")
    return module
