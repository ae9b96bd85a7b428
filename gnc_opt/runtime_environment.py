"""One thread for linear algebra, optional packages, and versions of installed ones.

On busy cores a hundred systems of 120 rows take 4 s with two threads and 0.03 s with one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib import import_module
from typing import Any

from gnc_opt.errors import GncOptError


def import_optional(package: str, extra: str) -> Any:
    """Return a package that an extra of gnc_opt brings; raise `GncOptError` with the install command."""
    try:
        module = import_module(package)
    except ImportError:
        module = None
    if getattr(module, "__file__", None) is None:  # a mere folder of that name can be imported, too
        raise GncOptError(f"{package} is not installed: pip install 'gnc_opt[{extra}]'.")
    return module


@lru_cache
def package_version(name: str) -> str:
    """Return an installed package's version, or "unknown"."""
    from importlib.metadata import PackageNotFoundError, version  # brings half of email along

    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


@contextmanager
def one_thread() -> Iterator[None]:
    """Let BLAS and LAPACK use one thread meanwhile, and as many as before afterwards; a decorator, too."""
    with _get_thread_controller().limit(limits=1, user_api="blas"):
        yield


@cache
def _get_thread_controller() -> Any:
    import scipy.linalg  # noqa: F401  (brings a library of its own, which must be there to be found)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
