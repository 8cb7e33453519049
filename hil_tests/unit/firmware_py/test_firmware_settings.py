"""Configuration files: valid values arrive typed, and errors name file and key."""

import enum
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from firmware_py import settings
from firmware_py.settings import SettingsError


class Gait(enum.Enum):
    SLOW = 1
    VERY_FAST = 2


@dataclass(frozen=True, slots=True)
class Axle:
    load_kg: float
    driven: bool = False

    def __post_init__(self) -> None:
        if self.load_kg < 0.0:
            raise ValueError(f"load_kg {self.load_kg} is negative")


@dataclass(frozen=True, slots=True)
class Wagon:
    name: str
    seats: int
    mass_kg: float
    axles: tuple[Axle, ...]
    gait: Gait = Gait.SLOW
    lead: Axle | None = None
    window_m: tuple[float, float] = (0.5, 1.5)
    notes: Mapping[str, str] = field(default_factory=dict)
    limits_mps: dict[str, float] = field(default_factory=dict)
    derived: float = field(init=False, default=0.0)


WAGON: dict[str, Any] = {
    "name": "A",
    "seats": 40,
    "mass_kg": 30_000,
    "axles": [{"load_kg": 7500.0}, {"load_kg": 7500, "driven": True}],
    "gait": "very_fast",
    "lead": {"load_kg": 1.0},
    "window_m": [1, 2],
    "notes": {"colour": "red"},
    "limits_mps": {"a": 1, "b": 2.5},
}


def with_change(**changes: Any) -> dict[str, Any]:
    return {**WAGON, **changes}


def refusal(table: dict[str, Any], tmp_path: Path) -> str:
    """The message about a file with this table, without the file and line with which it begins."""
    path = tmp_path / "wagon.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    with pytest.raises(SettingsError) as caught:
        settings.load(Wagon, str(path), "firmware_py.trackdb")
    found = re.fullmatch(rf"{re.escape(str(path))}(:\d+)?: (.*)", str(caught.value))
    assert found is not None
    return found[2]


def test_a_table_becomes_a_dataclass_with_every_value_of_its_type() -> None:
    wagon = settings.build(Wagon, WAGON, "wagon.toml")

    assert wagon == Wagon(
        name="A",
        seats=40,
        mass_kg=30_000.0,
        axles=(Axle(7500.0), Axle(7500.0, driven=True)),
        gait=Gait.VERY_FAST,
        lead=Axle(1.0),
        window_m=(1.0, 2.0),
        notes={"colour": "red"},
        limits_mps={"a": 1.0, "b": 2.5},
    )
    for number in (wagon.mass_kg, wagon.axles[1].load_kg, *wagon.window_m):
        assert isinstance(number, float)


def test_a_changed_file_is_read_again_and_a_wrong_one_is_refused_each_time(
    tmp_path: Path,
) -> None:
    path = tmp_path / "axle.toml"
    loads = []
    for load_kg in (1.0, 1.0, 2.0, 1.0):
        path.write_text(f"load_kg = {load_kg}")
        loads.append(settings.load(Axle, str(path), "firmware_py"))
    assert [each.load_kg for each in loads] == [1.0, 1.0, 2.0, 1.0]
    assert loads[0] is loads[1]

    path.write_text("load_kg = -1.0")
    for _ in range(2):
        with pytest.raises(SettingsError, match="is negative"):
            settings.load(Axle, str(path), "firmware_py")
    other = tmp_path / "other.toml"
    other.write_text("load_kg = -1.0")
    with pytest.raises(SettingsError, match=r"other\.toml"):
        settings.load(Axle, str(other), "firmware_py")


def test_a_key_with_a_default_may_be_omitted() -> None:
    wagon = settings.build(Wagon, {"name": "A", "seats": 1, "mass_kg": 1, "axles": []}, "w.toml")

    assert wagon == Wagon("A", 1, 1.0, ())


AXLES = st.builds(Axle, st.floats(0.0, allow_infinity=False), st.booleans())
WAGONS = st.builds(
    Wagon,
    name=st.text(st.characters(codec="utf-8")),
    seats=st.integers(-(2**60), 2**60),
    mass_kg=st.floats(allow_nan=False, allow_infinity=False),
    axles=st.lists(AXLES, max_size=3).map(tuple),
    gait=st.sampled_from(Gait),
    lead=st.none() | AXLES,
    notes=st.dictionaries(st.text(st.characters(codec="utf-8"), max_size=5), st.just("x")),
)


@given(wagon=WAGONS)
def test_a_file_written_from_settings_gives_the_same_settings(
    wagon: Wagon, tmp_path_factory: pytest.TempPathFactory
) -> None:
    table = {key: value for key, value in asdict(wagon).items() if value is not None}
    del table["derived"]
    table["gait"] = wagon.gait.name.lower()
    path = tmp_path_factory.mktemp("settings") / "wagon.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8", newline="")

    assert settings.load(Wagon, str(path), "firmware_py.trackdb") == wagon


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seat": 4}, "seat: unknown key; nearest valid key: seats"),
        ({"derived": 1.0}, "derived: unknown key; valid keys: name, seats, mass_kg, axles"),
        ({"lead": {"load_kg": 1.0, "drivn": True}}, "lead.drivn: unknown key; nearest valid"),
        ({"axles": [{"load_kg": 1.0}, {}]}, "axles[1].load_kg: missing key"),
        ({"axles": [{"load_kg": 1.0}, {"load_kg": "x"}]}, "axles[1].load_kg: 'x' is not a number"),
        ({"axles": [{"load_kg": -1.0}]}, "axles[0]: load_kg -1.0 is negative"),
        ({"axles": {"load_kg": 1.0}}, "axles: {'load_kg': 1.0} is not a list"),
        ({"axles": [3]}, "axles[0]: 3 is not a table"),
        ({"lead": 3}, "lead: 3 is not a table"),
        ({"name": 3}, "name: 3 is not a string"),
        ({"seats": 4.0}, "seats: 4.0 is not a whole number"),
        ({"seats": True}, "seats: True is not a whole number"),
        ({"seats": "4"}, "seats: '4' is not a whole number"),
        ({"mass_kg": True}, "mass_kg: True is not a number"),
        ({"mass_kg": float("nan")}, "mass_kg: nan is not a finite number"),
        ({"mass_kg": float("-inf")}, "mass_kg: -inf is not a finite number"),
        ({"lead": {"load_kg": 1.0, "driven": 1}}, "lead.driven: 1 is not true or false"),
        ({"gait": "very_fats"}, "gait: 'very_fats': nearest valid value: very_fast"),
        ({"gait": "xyz"}, "gait: 'xyz': valid values: slow, very_fast"),
        ({"gait": 2}, "gait: 2 is not one of slow, very_fast"),
        ({"window_m": [1.0]}, "window_m: 1 entries where 2 are needed"),
        ({"window_m": [1.0, "2"]}, "window_m[1]: '2' is not a number"),
        ({"notes": {"a": 1}}, "notes.a: 1 is not a string"),
        ({"notes": ["a"]}, "notes: ['a'] is not a table"),
        ({"limits_mps": {"a": "fast"}}, "limits_mps.a: 'fast' is not a number"),
    ],
)
def test_a_wrong_value_is_reported_with_file_key_and_value(
    change: dict[str, Any], said: str, tmp_path: Path
) -> None:
    assert refusal(with_change(**change), tmp_path).startswith(said)


@pytest.mark.parametrize("key", ["name", "seats", "mass_kg", "axles"])
def test_a_missing_key_is_named(key: str, tmp_path: Path) -> None:
    table = {name: value for name, value in WAGON.items() if name != key}

    assert refusal(table, tmp_path) == f"{key}: missing key"


@pytest.mark.parametrize(
    "content",
    [
        b"name = ",
        b"name = 1\nname = 2\n",
        b"\xff\xfe",
        b"seats = " + b"9" * 5000,
        b"seats = " + b"[" * 5000,
        b"seats = 2020-13-45",
        b"seats = 2020-01-01T00:00:00+99:99",
    ],
)
def test_invalid_toml_is_reported_with_the_file(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "wagon.toml"
    path.write_bytes(content)

    with pytest.raises(SettingsError, match="not TOML") as caught:
        settings.load(Wagon, str(path), "firmware_py.trackdb")

    assert str(path) in str(caught.value)


def test_a_number_that_no_float_holds_is_not_finite(tmp_path: Path) -> None:
    assert "is not a finite number" in refusal(with_change(mass_kg=10**400), tmp_path)


def test_a_date_is_refused_for_a_number(tmp_path: Path) -> None:
    path = tmp_path / "wagon.toml"
    path.write_text('name = "A"\nseats = 1\naxles = []\nmass_kg = 1979-05-27\n')

    with pytest.raises(SettingsError, match=r"mass_kg: .* is not a number"):
        settings.load(Wagon, str(path), "firmware_py.trackdb")


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for name, why in (
        (f"{tmp_path}/none.toml", "no such file"),
        (f"{tmp_path}/", "Is a directory"),
        (f"{tmp_path}/{'x' * 300}.toml", "File name too long"),
        (f"{__file__}/x.toml", "Not a directory"),
    ):
        with pytest.raises(SettingsError, match=why) as caught:
            settings.load(Wagon, name, "firmware_py.trackdb")
        assert str(Path(name)) in str(caught.value)


def test_an_unknown_shipped_name_is_reported_with_the_nearest() -> None:
    with pytest.raises(SettingsError, match="florenz: nearest valid shipped name: florence"):
        settings.find("florenz", "firmware_py.trackdb")
    with pytest.raises(SettingsError, match=r"xyz: valid shipped names: .*florence"):
        settings.find("xyz", "firmware_py.trackdb")
    with pytest.raises(SettingsError, match=r"^\.\.: is there, but is no \.toml file; valid"):
        settings.find("..", "firmware_py.trackdb")
    for name in ("x" * 300, "x\0", ""):
        with pytest.raises(SettingsError, match="shipped name"):
            settings.find(name, "firmware_py.trackdb")
    assert "florence" in settings.shipped_names("firmware_py.trackdb")


def test_a_field_that_no_file_can_fill_is_a_program_error() -> None:
    @dataclass(frozen=True, slots=True)
    class Odd:
        value: int | str

    with pytest.raises(TypeError, match="value"):
        settings.build(Odd, {"value": 1}, "odd.toml")


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.dates()
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)


@given(key=st.sampled_from([*WAGON, "other"]), value=VALUES)
def test_no_value_is_silently_converted(key: str, value: Any) -> None:
    """A value at any key either arrives unchanged or is refused with a message."""
    refused = ""
    try:
        wagon = settings.build(Wagon, with_change(**{key: value}), "wagon.toml")
    except SettingsError as error:
        refused = str(error)
    if refused:
        assert refused.startswith(f"wagon.toml: {key}")
        return

    arrived = getattr(wagon, key)
    if isinstance(arrived, Gait):
        assert arrived.name.lower() == value.lower()
    elif not isinstance(arrived, Axle | tuple):
        assert arrived == value


@dataclass(frozen=True, slots=True)
class Range:
    low: float
    high: float

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise ValueError(f"low {self.low} is over high {self.high}")


@dataclass(frozen=True, slots=True)
class Train:
    wagons: tuple[Wagon, ...]
    delay_s: Range
    doors: tuple[Axle, Range] = (Axle(1.0), Range(0.0, 1.0))
    spare: Wagon | None = None


TRAIN = Train(
    wagons=(settings.build(Wagon, WAGON, "a"), settings.build(Wagon, WAGON, "b")),
    delay_s=Range(0.4, 1.0),
)


def overridden(changes: Mapping[str, Any]) -> Train:
    return settings.override(TRAIN, changes, "train.toml")


def test_an_override_changes_only_its_key() -> None:
    train = overridden(
        {
            "wagons.1.mass_kg": 31_000,
            "wagons.1.axles.0.driven": True,
            "wagons.0.gait": "slow",
            "wagons.0.limits_mps.b": 3,
            "doors.0.load_kg": 2,
        }
    )

    first, second = TRAIN.wagons
    assert train.wagons[1] == replace(
        second, mass_kg=31_000.0, axles=(Axle(7500.0, True), Axle(7500.0, True))
    )
    assert train.wagons[0] == replace(first, gait=Gait.SLOW, limits_mps={"a": 1.0, "b": 3.0})
    assert train.doors == (Axle(2.0), Range(0.0, 1.0))
    assert train.delay_s == TRAIN.delay_s
    assert isinstance(train.wagons[1].mass_kg, float)


def test_without_changes_nothing_changes() -> None:
    assert overridden({}) == TRAIN


@pytest.mark.parametrize(
    ("changes", "delay_s"),
    [
        ({"delay_s": 0.7}, Range(0.7, 0.7)),
        ({"delay_s": 2}, Range(2.0, 2.0)),
        ({"delay_s.low": 0.5}, Range(0.5, 1.0)),
        ({"delay_s": {"high": 3.0}}, Range(0.4, 3.0)),
        ({"delay_s": {"low": 2.0, "high": 3.0}}, Range(2.0, 3.0)),
        ({"delay_s.low": 2.0, "delay_s.high": 3.0}, Range(2.0, 3.0)),
        ({"delay_s.low": 2.0, "delay_s": {"high": 3.0}}, Range(2.0, 3.0)),
    ],
)
def test_a_range_may_be_fixed_or_changed_by_its_ends(
    changes: dict[str, Any], delay_s: Range
) -> None:
    """Both ends given together are checked together, however they are written."""
    assert overridden(changes).delay_s == delay_s


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"wagns.0.seats": 3}, "wagns: unknown key; nearest valid key: wagons"),
        ({"wagons.0.seat": 3}, "wagons.0.seat: unknown key; nearest valid key: seats"),
        ({"wagons.2.seats": 3}, "wagons.2: no such entry; they are numbered 0 to 1"),
        ({"wagons.first.seats": 3}, "wagons.first: no such entry; they are numbered 0 to 1"),
        ({"wagons.-1.seats": 3}, "wagons.-1: no such entry; they are numbered 0 to 1"),
        ({"wagons.0.seats": "many"}, "wagons.0.seats: 'many' is not a whole number"),
        ({"wagons.0.gait": "fast"}, "wagons.0.gait: 'fast': nearest valid value: very_fast"),
        ({"wagons.0.mass_kg.low": 3.0}, "wagons.0.mass_kg: {'low': 3.0} is not a number"),
        ({"wagons.0.derived": 3.0}, "wagons.0.derived: unknown key"),
        ({"wagons": 3}, "wagons: 3 is not a list"),
        ({"delay_s": True}, "delay_s: True is not a table"),
        ({"delay_s": "late"}, "delay_s: 'late' is not a table"),
        ({"delay_s.low": 2.0}, "delay_s: low 2.0 is over high 1.0"),
        ({"delay_s.middle": 2.0}, "delay_s.middle: unknown key; valid keys: low, high"),
        ({"wagons.0.axles.1.load_kg": -1.0}, "wagons.0.axles.1: load_kg -1.0 is negative"),
        ({"delay_s": 1.0, "delay_s.low": 0.5}, "delay_s.low: changed twice"),
        ({"delay_s.low": 0.5, "delay_s": 1.0}, "delay_s: changed twice"),
        ({"delay_s.low": 0.5, "delay_s": {"low": 0.4}}, "delay_s: changed twice"),
        ({"": 1.0}, ": unknown key"),
        ({"delay_s.": 1.0}, "delay_s.: unknown key"),
        ({"spare.seats": 3}, "spare.name: missing key"),
    ],
)
def test_an_impossible_override_is_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingsError) as caught:
        overridden(changes)

    assert str(caught.value).startswith("train.toml: ")
    assert words in str(caught.value)


@given(
    key=st.sampled_from(["delay_s", "wagons.0.seats", "wagons.1.axles", "spare", "doors.1", "x.y"]),
    value=VALUES,
)
def test_no_override_is_silently_converted(key: str, value: Any) -> None:
    """An override is refused with a message, or gives a train that a file could describe."""
    refused = ""
    try:
        train = overridden({key: value})
    except SettingsError as error:
        refused = str(error)
    if refused:
        assert refused.startswith("train.toml: ")
        return

    assert isinstance(train.delay_s, Range)
    assert type(train.wagons[0].seats) is int
    assert all(isinstance(axle, Axle) for axle in train.wagons[1].axles)
    assert train.spare is None or isinstance(train.spare, Wagon)
