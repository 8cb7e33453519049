"""Blocks of documents: their marks, the order of documents, and the report of a failed block."""

from pathlib import Path

import pytest

from metro_tools.doc_blocks.blocks import Block, BlockMark, read_blocks
from metro_tools.doc_blocks.order import documents
from metro_tools.doc_blocks.session import DocumentOutcome, environment_of, run_document


def faults(text: str) -> list[tuple[int, str]]:
    return [(fault.line, fault.text) for fault in read_blocks(text)[1]]


def only(text: str) -> Block:
    blocks, wrong = read_blocks(text)
    assert wrong == []
    (block,) = blocks
    return block


@pytest.mark.parametrize(
    ("mark", "meant"),
    [
        ('run: prints "a"', BlockMark(run=True, prints=("a",))),
        ('run: prints "a, b", "c"', BlockMark(run=True, prints=("a, b", "c"))),
        ('run: exits 1, prints "a"', BlockMark(run=True, prints=("a",), exits=1)),
        ("skip: needs a CAN interface", BlockMark(skip="needs a CAN interface")),
        ("file: some/where.toml", BlockMark(file="some/where.toml")),
    ],
)
def test_a_mark_decides_the_treatment_of_the_block_below(mark: str, meant: BlockMark) -> None:
    block = only(f"Text.\n\n<!-- {mark} -->\n\n```sh\ntrue\n```\n")

    assert block.mark == meant
    assert (block.line, block.text, block.end) == (5, ("true",), 7)


@pytest.mark.parametrize("language", ["sh", "bash", "console", "python"])
def test_a_block_of_commands_needs_a_mark(language: str) -> None:
    ((line, text),) = faults(f"Text.\n```{language}\ntrue\n```\n")

    assert line == 2
    assert "says neither what it prints nor why it is not run" in text
    assert '<!-- run: prints "text" -->' in text


@pytest.mark.parametrize("language", ["", "text", "toml", "mermaid", "example PositionReport"])
def test_other_blocks_need_none(language: str) -> None:
    assert faults(f"```{language}\nspeed 3\n```\n") == []


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("<!-- run: -->\n```sh\ntrue\n```\n", 1, "expects nothing"),
        ('<!-- run: prints "" -->\n```sh\ntrue\n```\n', 1, "expects nothing"),
        ("<!-- run: exits 1 -->\n```sh\ntrue\n```\n", 1, "expects nothing"),
        ("<!-- run: prints a -->\n```sh\ntrue\n```\n", 1, "expects nothing"),
        ("<!-- run -->\n```sh\ntrue\n```\n", 1, "is empty"),
        ("<!-- skip: -->\n```sh\ntrue\n```\n", 1, "skip without a reason"),
        ("<!-- file: ../x -->\n```sh\ntrue\n```\n", 1, "is not the name of a file"),
        ("<!-- file: /x -->\n```sh\ntrue\n```\n", 1, "is not the name of a file"),
        ('<!-- run: prints "a" -->\nText.\n', 1, "stands above no block"),
        ('<!-- run: prints "a" -->\n```toml\na = 1\n```\n', 2, "a block of toml cannot be run"),
        ("```\n$ vobc run\n```\n", 1, "without a language"),
        ("Text:\n\n    vobc run --lockstep\n", 3, "in an indented block"),
        ("<!-- skip: x -->\n```sh\ntrue\n", 2, "is never closed"),
    ],
)
def test_every_error_is_reported_with_its_line(text: str, line: int, words: str) -> None:
    ((at, said),) = faults(text)

    assert at == line
    assert words in said


def test_marks_and_fences_inside_a_block_are_text() -> None:
    block = only("````text\n<!-- run: -->\n```sh\ntrue\n```\n````\n")

    assert block.text == ("<!-- run: -->", "```sh", "true", "```")


def test_documents_come_in_the_order_of_their_links(tmp_path: Path) -> None:
    (tmp_path / "docs" / "guide").mkdir(parents=True)
    for name, text in {
        "README.md": "[b](docs/guide/b.md#part), [a](docs/a.md), [web](https://x.org/docs/z.md)",
        "docs/guide/b.md": "[c](c.md) and [a](../a.md)",
        "docs/guide/c.md": "[home](../../README.md)",
        "docs/a.md": "[outside](../../x.md)",
        "docs/lonely.md": "",
    }.items():
        (tmp_path / name).write_text(text, encoding="utf-8")

    assert documents(tmp_path) == [
        "README.md",
        "docs/guide/b.md",
        "docs/a.md",
        "docs/guide/c.md",
        "docs/lonely.md",
    ]


def ran(tmp_path: Path, text: str, seconds: float = 60.0) -> DocumentOutcome:
    blocks, wrong = read_blocks(text)
    assert wrong == []
    clone = tmp_path / "clone"
    clone.mkdir()
    return run_document(
        "docs/x.md", text, blocks, clone, environment_of(clone, tmp_path), block_seconds=seconds
    )


def test_blocks_of_a_document_share_folder_variables_and_files(tmp_path: Path) -> None:
    outcome = ran(
        tmp_path,
        '<!-- run: prints "one" -->\n```sh\nWORD=one\nmkdir in; cd in\necho $WORD\n```\n'
        "<!-- skip: would fail -->\n```sh\nfalse\n```\n"
        "<!-- file: to/read.txt -->\n```toml\na = 'saved'\n```\n"
        '<!-- run: prints "one", "saved", "two" -->\n'
        "```sh\necho $WORD; cat to/read.txt\ncat <<X\ntwo\nX\n```\n"
        '<!-- run: prints "three" -->\n```console\n$ echo three\nthree\n$ true\n```\n',
    )

    assert outcome == DocumentOutcome(3, None)
    assert (tmp_path / "clone" / "in" / "to" / "read.txt").is_file()


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("echo a\nfalse\necho b", "docs/x.md:5: exit status 1 of: false\n    | a"),
        ("echo b", 'docs/x.md:3: the output lacks "a"; correct the block, or the mark above it\n'),
        ("echo a\nexit 0", "docs/x.md:3: bash ended here; correct the command, or remove `exit`"),
        ("echo 'a", "docs/x.md:3: bash ended here"),
        (
            "echo a; echo 'Traceback (most recent call last):'",
            "docs/x.md:3: a program of this block ended with a traceback",
        ),
        ("no-such-program", "docs/x.md:4: exit status 127 of: no-such-program\n    | "),
    ],
)
def test_a_failure_names_file_line_and_command(tmp_path: Path, block: str, message: str) -> None:
    outcome = ran(
        tmp_path,
        f'Text.\n<!-- run: prints "a" -->\n```sh\n{block}\n```\n'
        '<!-- run: prints "later" -->\n```sh\necho later\n```\n',
    )

    assert outcome.ran == 0
    assert str(outcome.failure).startswith(message)


def test_an_expected_failure_must_come(tmp_path: Path) -> None:
    outcome = ran(
        tmp_path,
        '<!-- run: exits 3, prints "a" -->\n```sh\necho a; (exit 3)\n```\n'
        '<!-- run: exits 1, prints "b" -->\n```sh\necho b\n```\n',
    )

    assert outcome.ran == 1
    assert str(outcome.failure).startswith(
        "docs/x.md:6: exit status 0; the mark above this block expects 1"
    )


def test_python_is_run_with_the_lines_of_the_document(tmp_path: Path) -> None:
    outcome = ran(
        tmp_path,
        '<!-- run: prints "3" -->\n```python\nprint(1 + 2)\n```\n\n'
        '<!-- run: prints "x" -->\n```python\nprint("x")\nraise ValueError\n```\n',
    )

    assert outcome.ran == 1
    assert outcome.failure is not None
    assert "line 9, in <module>" in outcome.failure.output


def test_a_block_that_hangs_is_ended_together_with_its_background_processes(tmp_path: Path) -> None:
    outcome = ran(
        tmp_path, '<!-- run: prints "a" -->\n```sh\nsleep 600 &\nwait\n```\n', seconds=0.2
    )

    assert str(outcome.failure).startswith("docs/x.md:2: not done after 0.2 s; shorten it")
