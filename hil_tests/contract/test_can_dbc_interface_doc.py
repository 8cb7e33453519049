"""The committed interface document agrees with the DBC files."""

from pathlib import Path

import pytest

from can_dbc import binding
from can_dbc.nodes import Node
from metro_tools import interface_doc

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "can_interface.md"


def test_the_committed_document_is_current() -> None:
    assert interface_doc.main(["--check", str(DOCUMENT)]) == 0, (
        "run python -m metro_tools.interface_doc in the project's folder"
    )


def test_every_node_message_signal_and_choice_is_in_it() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")

    for node in Node:
        assert f"| {node.value} | {node.name} | " in text
    for kind in binding.kinds():
        for message in binding.binding_of(kind).messages:
            assert f"| {message.frame_id:#05x} | {message.name} | {message.senders[0]} | " in text
        for signal in binding.message(kind).signals:
            assert f"| `{signal.name}` | {signal.start}" in text
            assert signal.comment is not None
            assert signal.comment in text
            for raw, name in (signal.choices or {}).items():
                assert f"{raw} {name}" in text


def test_the_check_fails_for_any_other_text(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "can_interface.md"
    assert interface_doc.main([str(path)]) == 0
    assert interface_doc.main(["--check", str(path)]) == 0
    path.write_text(path.read_text(encoding="utf-8") + "\n", encoding="utf-8")

    assert interface_doc.main(["--check", str(path)]) == 1
    assert "outdated; run python -m metro_tools.interface_doc" in capsys.readouterr().err


def test_a_missing_marker_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options in ([], ["--check"]):
        assert interface_doc.main([*options, str(tmp_path / "no" / "where.md")]) == 2
        assert "where.md: No such file or directory" in capsys.readouterr().err


def test_frame_lengths_are_those_of_the_standard() -> None:
    """ISO 11898: an 8-byte frame takes 111 bit times with its gap, and at most 135 with
    stuffing."""
    assert (interface_doc.plain_bits(8), interface_doc.stuffed_bits(8)) == (111, 135)
    assert (interface_doc.plain_bits(0), interface_doc.stuffed_bits(0)) == (47, 55)
