"""What callers may leave out, and what it is then: parameters and defaults of public names, as they were decided on.

``python tests/api/test_signatures.py`` writes the list anew, ``signatures.txt``; who changes a line of it changes what
programs of users mean, and says so in the changelog.
"""

import dataclasses
import enum
import inspect
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

PACKAGES = [
    "", ".control", ".estimation", ".guidance", ".simulation", ".analysis", ".spacecraft", ".plot", ".report",
]  # fmt: skip
LIST = Path(__file__).with_name("signatures.txt")


def public() -> Iterator[tuple[str, object]]:
    """Each public class and function once, by the shortest of its names."""
    seen = set()
    for package in PACKAGES:
        module = import_module(f"gnc_opt{package}")
        for name in sorted(module.__all__):
            value = getattr(module, name)
            if callable(value) and id(value) not in seen:
                seen.add(id(value))
                yield f"{package[1:]}.{name}".lstrip("."), value


def told(value: object) -> str:
    """A default; functions by their names."""
    return getattr(value, "__qualname__", None) or repr(value)


def line(name: str, function: Callable[..., object]) -> str:
    """Name and parameters without annotations; "" if nothing can be left out."""
    signature = inspect.signature(function)
    bare = [p.replace(annotation=p.empty) for p in signature.parameters.values()]
    parameters, star = [], False
    for p in bare:
        if p.name in ("self", "cls"):
            continue
        if p.kind is p.KEYWORD_ONLY and not star:
            parameters.append("*")
        star = star or p.kind in (p.KEYWORD_ONLY, p.VAR_POSITIONAL)
        parameters.append(str(p) if p.default is p.empty else f"{p.name}={told(p.default)}")
    optional = any(p.default is not p.empty for p in bare)
    return f"{name}({', '.join(parameters)})" if optional or "*" in parameters else ""


def lines() -> Iterator[str]:
    for name, value in public():
        if inspect.isfunction(value):
            yield line(name, value)
        if not inspect.isclass(value) or issubclass(value, (enum.Enum, BaseException)):
            continue
        yield line(name, value)
        for each, member in sorted(vars(value).items()):
            function = getattr(member, "__func__", member)
            if inspect.isfunction(function) and not each.startswith("_"):
                yield line(f"{name}.{each}", function)
        yield from hidden(name, value)


def hidden(name: str, cls: type) -> Iterator[str]:
    """Fields that are not printed, and those that make no difference between two equal ones."""
    if not dataclasses.is_dataclass(cls):
        return
    fields = dataclasses.fields(cls)
    silent = [f.name for f in fields if not f.repr]
    alike = [f.name for f in fields if not f.compare] if cls.__dataclass_params__.eq else []  # type: ignore[attr-defined]
    for what, names in (("not printed", silent), ("not compared", alike)):
        if names:
            yield f"{name}: {', '.join(names)} {what}"


def found() -> list[str]:
    return [text for text in lines() if text]


def test_what_may_be_left_out_is_as_decided() -> None:
    remedy = "if that is meant, write the list anew: python tests/api/test_signatures.py"
    assert found() == LIST.read_text(encoding="utf-8").splitlines(), remedy


if __name__ == "__main__":
    LIST.write_text("\n".join(found()) + "\n", encoding="utf-8")
