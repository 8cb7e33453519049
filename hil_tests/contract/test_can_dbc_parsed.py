"""Programs start from the parsed DBC files, which say the same as the DBC files."""

from pathlib import Path

import pytest

from can_dbc import dbc_file, parsed_files
from metro_tools import parsed_dbc

COMMITTED = Path(dbc_file.__file__).with_name(parsed_files.NAME)


def test_the_committed_file_is_current() -> None:
    assert parsed_dbc.main(["--check", str(COMMITTED)]) == 0, (
        "run python -m metro_tools.parsed_dbc in the project's folder"
    )


@pytest.mark.parametrize("name", dbc_file.names())
def test_what_programs_start_from_is_what_the_parser_reads(name: str) -> None:
    text = dbc_file.text_of(name)

    assert parsed_files.find(name, text) is not None
    assert dbc_file.shipped(name) == dbc_file.parse(text, name)


def test_a_changed_file_is_parsed_again() -> None:
    text = dbc_file.text_of("brake.dbc")

    assert parsed_files.find("brake.dbc", text + "\n") is None
    assert parsed_files.find("other.dbc", text) is None
