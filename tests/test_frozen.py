"""Records made by `frozen` behave as those of `dataclass(frozen=True)`."""

import copy
import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Generic, TypeVar

import pytest

from mocap_calib.frozen import frozen

T = TypeVar("T")


def _make(decorator: Callable[[type], type]) -> Any:
    class Limb:
        kind: ClassVar[str] = "limb"
        length: float
        joints: tuple[str, ...] = ()
        note: str = field(default="", compare=False)
        secret: str = field(default="x", repr=False)

    return decorator(Limb)


OURS = _make(frozen)
THEIRS = _make(dataclass(frozen=True))


@frozen
class Bone:
    """A record that turns what it is given into a tuple, as many do."""

    joints: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(self.joints))


@frozen
class LongBone(Bone):
    """A record that inherits."""

    length: float = 1.0

    def __repr__(self) -> str:
        return "long"


@pytest.mark.parametrize("limb", [OURS, THEIRS], ids=["ours", "theirs"])
def test_records_compare_hash_and_print_by_what_they_hold(limb: Any) -> None:
    one = limb(0.4, ("hip", "knee"))
    same = limb(length=0.4, joints=("hip", "knee"), note="other")
    assert one == same
    assert hash(one) == hash(same)
    assert one != limb(0.5, ("hip", "knee"))
    assert one != (0.4, ("hip", "knee"), "x")
    assert repr(one).endswith("Limb(length=0.4, joints=('hip', 'knee'), note='')")
    assert [each.name for each in fields(one)] == ["length", "joints", "note", "secret"]


def test_hashes_are_those_of_dataclasses() -> None:
    assert hash(OURS(0.4, ("hip",))) == hash(THEIRS(0.4, ("hip",)))


@pytest.mark.parametrize("limb", [OURS, THEIRS], ids=["ours", "theirs"])
def test_records_cannot_be_changed(limb: Any) -> None:
    record = limb(0.4)
    for name in ("length", "joints", "kind", "new"):
        with pytest.raises(FrozenInstanceError, match=f"cannot assign to field '{name}'"):
            setattr(record, name, 1)
    with pytest.raises(FrozenInstanceError, match="cannot delete field 'length'"):
        del record.length
    assert record == limb(0.4)
    assert replace(record, length=0.5) == limb(0.5)
    with pytest.raises(TypeError, match="size"):
        limb(0.4, size=1)


@frozen
class Leg(Generic[T]):
    """A record of all else that records have."""

    bones: list[T] = field(default_factory=list)
    side: str = field(default="left", kw_only=True)

    @cached_property
    def number(self) -> int:
        return len(self.bones)


def test_defaults_keywords_and_what_is_kept_work_as_in_dataclasses() -> None:
    first, second = Leg[int](), Leg[int]([1, 2], side="right")
    assert (first.number, second.number) == (0, 2)
    assert first.bones is not Leg[int]().bones
    assert first == Leg([])
    with pytest.raises(TypeError, match="positional"):
        Leg([], "right")  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        second.number = 3  # type: ignore[misc]


def test_records_are_copied_and_pickled() -> None:
    record = LongBone(["hip", "knee"], length=0.4)  # type: ignore[arg-type]
    assert record.joints == ("hip", "knee")
    assert copy.copy(record) == copy.deepcopy(record) == record
    assert pickle.loads(pickle.dumps(record)) == record


def test_methods_of_a_class_and_of_those_above_it_are_kept() -> None:
    assert repr(LongBone(("hip",))) == "long"
    assert LongBone(("hip",)) != Bone(("hip",))

    @frozen
    class Same(LongBone):
        pass

    assert repr(Same(("hip",))) == "long"
