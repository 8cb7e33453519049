"""Messages about a TOML file name the line of the key."""

from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from firmware_py import settings
from firmware_py.settings import SettingsError, located
from firmware_py.toml_lines import key_lines, line_of

TEXT = '''# one comment
name = "a = b # no comment"
"quoted key" = 1
text = """
[not.a.header]
no = 'key'
"""
list = [
    1,  # ]
    { inner = 2 },
]
train.load = "AW2"

[train.brake]
'gain ratio' = 1.0

[[scenario]]
name = "one"

[[scenario.fault]]
kind = "a"
[[scenario.fault]]
kind = "b"
[scenario.fault.when]
speed_mps = 3

[[scenario]]
[[scenario.fault]]
kind = "c"
'''


def test_each_key_and_header_has_its_line() -> None:
    assert key_lines(TEXT) == {
        "name": 2,
        "quoted key": 3,
        "text": 4,
        "list": 8,
        "train.load": 12,
        "train.brake": 14,
        "train.brake.gain ratio": 15,
        "scenario[0]": 17,
        "scenario[0].name": 18,
        "scenario[0].fault[0]": 20,
        "scenario[0].fault[0].kind": 21,
        "scenario[0].fault[1]": 22,
        "scenario[0].fault[1].kind": 23,
        "scenario[0].fault[1].when": 24,
        "scenario[0].fault[1].when.speed_mps": 25,
        "scenario[1]": 27,
        "scenario[1].fault[0]": 28,
        "scenario[1].fault[0].kind": 29,
    }


@pytest.mark.parametrize(
    ("message", "line"),
    [
        ("scenario[0].fault[1].kind: 'x': nearest valid value: b", 23),
        ("scenario[0].fault[1].speed: missing key", 22),
        ("scenario[1].name: missing key", 27),
        ("list[1].inner: 2 is not a string", 8),
        ('train.brake."gain ratio": 1.0 is too small', 15),
        ("train.load 'AW2' is not a load", 12),
        ("names: unknown key", None),
        ("the file has no scenario", None),
    ],
)
def test_a_message_has_the_line_of_its_key_or_of_the_table_that_misses_it(
    message: str, line: int | None
) -> None:
    assert line_of(key_lines(TEXT), message) == line


KEYS = st.text("abcXYZ_09-", min_size=1, max_size=6)
VALUES = st.recursive(
    st.integers() | st.booleans() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=12,
)


@given(st.dictionaries(KEYS, VALUES, max_size=5))
def test_every_line_found_is_one_that_holds_the_key(table: dict[str, Any]) -> None:
    text = tomli_w.dumps(table)
    lines = text.split("\n")

    found = key_lines(text)

    assert {key for key in table if not isinstance(table[key], dict | list)} <= set(found)
    for key, number in found.items():
        name = key.split(".")[-1].split("[")[0]
        assert name in lines[number - 1]


def test_a_refused_file_is_named_with_the_line(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"

    with pytest.raises(SettingsError) as caught, located(str(path), TEXT):
        raise SettingsError(f"{path}: scenario[1].fault[0].kind: 'c' is none\n{path}: whole file")

    assert str(caught.value) == (
        f"{path}:29: scenario[1].fault[0].kind: 'c' is none\n{path}: whole file"
    )


def test_a_line_file_is_refused_with_the_line_of_its_mistake(tmp_path: Path) -> None:
    from firmware_py.trackdb import load_line

    shipped = settings.find("florence", "firmware_py.trackdb").read_text(encoding="utf-8")
    path = tmp_path / "own.toml"
    path.write_text(shipped + "\n[[stations]]\nnmae = 'x'\n", encoding="utf-8")

    with pytest.raises(SettingsError) as caught:
        load_line(str(path))

    number = shipped.count("\n") + 3
    assert str(caught.value).startswith(f"{path}:{number}: stations[")


def test_text_that_is_not_toml_keeps_its_message() -> None:
    text = "[train\nname = 1\n= 2\n"
    with (
        pytest.raises(SettingsError, match=r"^a\.toml: not TOML: .*line 1"),
        located("a.toml", text),
    ):
        settings.tables_of(text, "a.toml")
