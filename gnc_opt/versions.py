"""Versions of installed packages."""

from __future__ import annotations

from functools import lru_cache


@lru_cache
def package_version(name: str) -> str:
    """Return an installed package's version, or "unknown"."""
    from importlib.metadata import PackageNotFoundError, version  # brings half of email along

    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
