"""Packing: whatever dataclasses hold comes back bit by bit, and what cannot come back is refused when it is saved."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from testing.bitwise_equality import assert_same

from gnc_opt.errors import GncOptError
from gnc_opt.npz_result_files import DataclassSerializer, FileFormat


class Colour(Enum):
    RED = "red"
    BLUE = 7


@dataclass(frozen=True)
class Leaf:
    name: str
    value: float
    colour: Colour = Colour.RED


@dataclass(frozen=True, eq=False)
class Tree:
    count: int
    flag: bool
    nothing: None
    text: str
    number: float
    colour: Colour
    leaf: Leaf
    leaves: tuple[Leaf, ...]
    matrix: Any
    pieces: tuple[Any, ...]
    mixed: tuple[Any, ...]
    names: dict[str, Any]
    secret: Any = field(default=None)


PACKING = DataclassSerializer((Tree, Leaf, Colour), left_out={Tree: ("secret",)})
FILES = FileFormat(Tree, "tree", 3, PACKING)

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
TEXTS = st.text(st.characters(blacklist_categories=["Cs"]), max_size=8)
LEAVES = st.builds(Leaf, TEXTS, NUMBERS, st.sampled_from(Colour))
DTYPES = st.sampled_from([np.float64, np.float32, np.int64, np.int32, np.bool_, np.uint8])
ARRAYS = DTYPES.flatmap(
    lambda kind: hnp.arrays(kind, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3))
)
PIECES = st.lists(hnp.arrays(np.float64, st.tuples(st.just(2), st.integers(0, 3))), max_size=4).map(tuple)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | NUMBERS | TEXTS | LEAVES | ARRAYS | st.sampled_from(Colour),
    lambda inner: st.lists(inner, max_size=3).map(tuple) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=6,
)
TREES = st.builds(
    Tree,
    count=st.integers(),
    flag=st.booleans(),
    nothing=st.none(),
    text=TEXTS,
    number=NUMBERS,
    colour=st.sampled_from(Colour),
    leaf=LEAVES,
    leaves=st.lists(LEAVES, max_size=2)
    .flatmap(lambda few: st.lists(st.sampled_from(few or [Leaf("", 0.0)])))
    .map(tuple),
    matrix=ARRAYS,
    pieces=PIECES,
    mixed=st.lists(VALUES, max_size=3).map(tuple),
    names=st.dictionaries(TEXTS, VALUES, max_size=4),
    secret=st.just("not written"),
)


@settings(max_examples=60)
@given(TREES)
def test_every_field_survives(tree: Tree) -> None:
    arrays: dict[str, Any] = {}
    text = json.dumps(PACKING.serialise_to_json_tree(tree, "", arrays), allow_nan=False)
    assert_same(tree, PACKING.restore_result_from_json_tree(json.loads(text), arrays))


@settings(max_examples=20)
@given(TREES, VALUES)
def test_every_field_survives_the_file(
    tmp_path_factory: pytest.TempPathFactory, tree: Tree, more: Any
) -> None:
    path = FILES.write_result_file(tmp_path_factory.mktemp("files") / "tree", tree, more=more)
    again, others = FILES.read_result_file(path)
    assert_same(tree, again)
    assert again.secret is None
    assert list(others) == ["more"]
    assert_same(more, others["more"])


def test_what_is_alike_is_written_once() -> None:
    leaves = (Leaf("a", 1.0), Leaf("b", math.nan), Leaf("a", 1.0), Leaf("a", -0.0), Leaf("a", 0.0)) * 1000
    arrays: dict[str, Any] = {}
    packed = PACKING.serialise_to_json_tree(leaves, "leaves", arrays)
    assert len(json.dumps(packed)) < 1000
    assert arrays["leaves"].shape == (5000,)
    assert_same(leaves, PACKING.restore_result_from_json_tree(packed, arrays))  # also the sign of zero
    arrays.clear()
    assert len(PACKING.serialise_to_json_tree(leaves[:2], "leaves", arrays)) == 2 and not arrays


def test_arrays_that_were_read_cannot_be_changed() -> None:
    arrays: dict[str, Any] = {}
    tree = PACKING.serialise_to_json_tree({"x": np.zeros(3)}, "", arrays)
    assert not PACKING.restore_result_from_json_tree(tree, arrays)["x"].flags.writeable


def test_pieces_are_one_entry() -> None:
    pieces = tuple(np.full((2, n), float(n)) for n in range(50))
    arrays: dict[str, Any] = {}
    packed = PACKING.serialise_to_json_tree(pieces, "x", arrays)
    assert list(arrays) == ["x"] and arrays["x"].shape == (2, sum(range(50)))
    assert_same(pieces, PACKING.restore_result_from_json_tree(packed, arrays))


def test_places_that_would_be_the_same_entry_are_kept_apart() -> None:
    names = {
        "a.b": np.zeros(1), "a": {"b": np.ones(1)}, "a/b": np.ones(2), "a\\b": np.ones(3), "a\0": np.ones(4),
    }  # fmt: skip
    arrays: dict[str, Any] = {}
    packed = PACKING.serialise_to_json_tree(names, "", arrays)
    assert len(arrays) == 5 and not any(set(name) & set("/\\\0") for name in arrays)
    assert_same(names, PACKING.restore_result_from_json_tree(packed, arrays))


@dataclass(frozen=True)
class Stranger:
    value: float


class Shade(Enum):
    DARK = 1


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (Stranger(1.0), "'names.x' cannot be saved: files cannot store a Stranger"),
        (Shade.DARK, "'names.x' cannot be saved: files cannot store a Shade"),
        ({1: 2.0}, "'names.x' cannot be saved: its keys are not all names"),
        (object(), "files cannot store a object"),
        (1j, "files cannot store a complex"),
        ([lambda: 1], r"'names.x.0' cannot be saved: files cannot store a function"),
        (np.array([Stranger(1.0)], dtype=object), "an array of Python objects"),
    ],
)
def test_what_would_not_come_back_is_refused(value: Any, message: str, tmp_path: Path) -> None:
    leaf = Leaf("", 0.0)
    tree = Tree(1, True, None, "", 0.0, Colour.RED, leaf, (), np.zeros(1), (), (), {"x": value})
    with pytest.raises(GncOptError, match=message):
        FILES.write_result_file(tmp_path / "tree", tree)
    assert not list(tmp_path.iterdir())


def test_classes_that_are_not_listed_are_never_made() -> None:
    packed = {"type": "Stranger", "fields": {"value": 1.0}}
    with pytest.raises(KeyError):
        PACKING.restore_result_from_json_tree(packed, {})


def test_older_versions_are_read_and_unknown_ones_refused(tmp_path: Path) -> None:
    old = FileFormat(Leaf, "leaf", 1, DataclassSerializer((Leaf, Colour)))
    path = old.write_result_file(tmp_path / "leaf", Leaf("oak", 1.0))
    new = FileFormat(Leaf, "leaf", 2, DataclassSerializer((Leaf, Colour)), alike=(1,))
    assert new.read_result_file(path) == (Leaf("oak", 1.0), {})
    newest = new.write_result_file(tmp_path / "leaf2", Leaf("oak", 1.0), written_by="9.9")
    with pytest.raises(GncOptError, match=r"format version 2 \(gnc_opt 9\.9\).*reads version 1"):
        old.read_result_file(newest)


def test_the_result_must_be_of_its_class(tmp_path: Path) -> None:
    path = FileFormat(Leaf, "tree", 3, PACKING).write_result_file(tmp_path / "leaf", Leaf("oak", 1.0))
    with pytest.raises(GncOptError, match="is damaged"):
        FILES.read_result_file(path)
