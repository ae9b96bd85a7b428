"""Versions of installed packages."""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version


@lru_cache
def package_version(name: str) -> str:
    """Return an installed package's version, or "unknown"."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
