"""Generated constructors of the compiled copy behave like those of `dataclass`."""

from typing import Any, get_type_hints

import pytest

from metro_tools.written_inits import (
    bases_in,
    heads_in,
    with_kept_types,
    with_native_records,
    with_written_inits,
)

HEAD = "from dataclasses import dataclass, field\nfrom typing import ClassVar, Protocol\n"
PLAIN = '''
@dataclass(frozen=True, slots=True)
class Place:
    """Where."""

    at_m: float
    """Chainage."""
    name: str | None = None
    sides: tuple[int, ...] = ()

    @property
    def known(self) -> bool:
        return self.name is not None
'''
CHECKED = """
@dataclass(slots=True)
class Checked:
    least: int
    most: int = 5

    def __post_init__(self) -> None:
        if self.least > self.most:
            raise ValueError("none between")
"""
RECORDS = '''
from typing import (
    Final,
    NamedTuple,
)

LEAST: Final = 1


class Spot(NamedTuple):
    """Where, and of what kind: words
    over two lines."""

    at_m: float
    """Chainage."""
    kind: str | None = None
    """Of the thing."""

    @property
    def known(self) -> bool:
        return self.kind is not None


class Pair(NamedTuple):
    left: int
    right: int
'''
UNUSUAL = (
    "@dataclass(frozen=True, order=True)\nclass Unusual:\n    a: int\n",
    "@dataclass(frozen=True)\nclass Unusual:\n    a: list[int] = field(default_factory=list)\n",
    "@dataclass(frozen=True)\nclass Unusual:\n    a: ClassVar[int] = 1\n    b: int = 2\n",
    "@dataclass(frozen=True)\nclass Unusual(Exception):\n    a: int\n",
    "@dataclass\nclass Unusual:\n    a: int\n",
    "@dataclass(frozen=True)\nclass Unusual:\n    pass\n",
    "class Unusual(Protocol):\n    a: int\n",
)


def made(source: str, name: str) -> Any:
    """The class after the module has run."""
    space: dict[str, Any] = {"__name__": __name__}
    exec(source, space)  # noqa: S102
    return space[name]


def test_a_plain_dataclass_gets_an_equal_constructor() -> None:
    written = with_written_inits(HEAD + PLAIN)

    assert (
        "def __init__(self, at_m: float, name: str | None = None, sides: tuple[int, ...] = ())"
        in written
    )
    assert "self.at_m = at_m; self.name = name; self.sides = sides" in written
    assert "return self.name is not None" in written


def test_a_mutable_class_behaves_the_same_with_a_generated_constructor() -> None:
    plain, written = (
        made(HEAD + CHECKED, "Checked"),
        made(with_written_inits(HEAD + CHECKED), "Checked"),
    )

    assert repr(written(2)) == repr(plain(2)) == "Checked(least=2, most=5)"
    assert written(1, most=3) == written(1, 3)
    assert written.__init__.__code__.co_varnames == ("self", "least", "most")
    for kind in (plain, written):
        with pytest.raises(ValueError, match="none between"):
            kind(6)


@pytest.mark.parametrize("source", UNUSUAL)
def test_a_class_that_is_not_plain_stays_unchanged(source: str) -> None:
    assert with_written_inits(HEAD + source) == HEAD + source


def test_a_record_keeps_its_fields_and_makes_changed_copies() -> None:
    plain, written = made(RECORDS, "Spot"), made(with_native_records(RECORDS), "Spot")

    assert repr(written(2.0)) == repr(plain(2.0)) == "Spot(at_m=2.0, kind=None)"
    assert written(2.0)._replace(kind="balise") == written(2.0, "balise")
    assert written(2.0, "balise")._replace(kind=None) == written(2.0)
    assert written(2.0, "balise").known
    assert written(2.0) != written(3.0)
    assert written(2.0) != (2.0, None)
    assert hash(written(2.0)) == hash(written(2.0))


def test_a_record_gets_a_constructor_like_any_frozen_class() -> None:
    written = with_written_inits(with_native_records(RECORDS))

    assert "def __init__(self, left: int, right: int) -> None: " in written
    assert "def __init__(self, at_m: float, kind: str | None = None) -> None: " in written


def test_a_record_used_as_a_tuple_stays_a_tuple() -> None:
    written = with_native_records(RECORDS, ["Pair"])

    left, right = made(written, "Pair")(1, 2)
    assert (left, right) == (1, 2)
    assert not isinstance(made(written, "Spot")(2.0), tuple)
    assert with_native_records(RECORDS, ["Pair", "Spot"]) == RECORDS


def test_generated_records_keep_every_other_line_number() -> None:
    before, after = RECORDS.splitlines(), with_native_records(RECORDS).splitlines()

    assert len(after) == len(before)
    for line in ("LEAST: Final = 1", "    at_m: float", "        return self.kind is not None"):
        assert after.index(line) == before.index(line)


def test_every_class_of_a_module_is_found() -> None:
    written = with_written_inits(HEAD + PLAIN + CHECKED)

    assert written.count("def __init__(") == 2
    assert made(with_written_inits(HEAD + CHECKED + CHECKED), "Checked")(1).least == 1


def test_every_other_line_keeps_its_number() -> None:
    source = HEAD + PLAIN + CHECKED + "\nLAST = 1\n"

    pairs = zip(source.splitlines(), with_written_inits(source).splitlines(), strict=True)

    changed = [(one, other) for one, other in pairs if one != other]
    assert [one for one, _ in changed] == ["", ""]


def test_a_class_that_others_inherit_from_stays_as_it_is() -> None:
    heir = "@dataclass(slots=True)\nclass Heir(module.Base):\n    two: int\n"
    base = "@dataclass(slots=True)\nclass Base:\n    one: int\n"

    assert bases_in(base) == set()
    assert bases_in(heir) == {"Base"}
    assert with_written_inits(base, bases_in(heir)) == base
    assert "__init__" in with_written_inits(base)


def test_subclasses_of_a_plain_dataclass_get_its_fields_first() -> None:
    base = "@dataclass(slots=True)\nclass Base:\n    one: int\n\n"
    heir = "@dataclass(slots=True)\nclass Heir(Base):\n    two: int = 2\n\n"
    other = "@dataclass(slots=True)\nclass Other(Unknown):\n    two: int = 2\n"
    heads = heads_in(HEAD + base)

    written = with_written_inits(HEAD + base + heir, bases_in(base + heir), heads)

    assert "def __init__(self, one: int, two: int = 2)" in written
    assert repr(made(written, "Heir")(1)) == repr(made(HEAD + base + heir, "Heir")(1))
    assert repr(made(written, "Base")(1)) == "Base(one=1)"
    assert with_written_inits(other, {"Unknown"}, heads) == other


def test_types_of_fields_are_kept_at_the_end_of_the_module() -> None:
    source = HEAD + CHECKED + PLAIN + "class Other:\n    a: int = 1\n"
    kept = with_kept_types(source)

    assert kept.startswith(source)
    assert kept[len(source) :].splitlines() == [
        "setattr(Checked, '__annotations__', {'least': int, 'most': int})",
        "setattr(Place, '__annotations__', "
        "{'at_m': float, 'name': str | None, 'sides': tuple[int, ...]})",
    ]


def test_lost_annotations_are_restored() -> None:
    """mypyc makes every annotation `object` in this way."""
    lost = 'Place.__annotations__ = {"at_m": object, "name": object, "sides": object}\n'
    without = get_type_hints(made(HEAD + PLAIN + lost, "Place"))
    line = with_kept_types(HEAD + PLAIN)[len(HEAD + PLAIN) :]
    with_them = get_type_hints(made(HEAD + PLAIN + lost + line, "Place"))

    assert without["at_m"] is object
    assert with_them == {"at_m": float, "name": str | None, "sides": tuple[int, ...]}


def test_fields_by_keyword_stay_so() -> None:
    source = "@dataclass(frozen=True, kw_only=True)\nclass Named:\n    one: int\n    two: int = 2\n"

    assert "def __init__(self, *, one: int, two: int = 2) -> None:" in with_written_inits(source)
