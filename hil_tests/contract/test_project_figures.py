"""Figures and pictures of the documents come from kept results, or tell when they were measured."""

from pathlib import Path
from typing import Final

import pytest

from metro_tools import figure_doc, picture_doc
from metro_tools.doc_blocks.order import documents

ROOT: Final = Path(__file__).resolve().parents[2]
IMAGES: Final = ROOT / picture_doc.IMAGES
KEPT: Final = {
    "cases": 21,
    "stops": 84,
    "missed": 1,
    "mean_m": 0.00185,
    "worst_m": -0.0345,
    "run_s": 497.0,
    "load_means_m": {"0": 0.0126, "0.5": 0.0097},
    "comfort": {
        "jerk_max_mps3": 0.7413,
        "notch_changes_max_count": 15.0,
        "felt_jerk_1s_mps3": None,
    },
}


def test_the_documents_hold_the_kept_figures() -> None:
    """When this fails, run `make docs`."""
    assert figure_doc.main(["--check", str(ROOT)]) == 0


def test_every_picture_has_its_commands_and_is_used() -> None:
    recipes = picture_doc.read_recipes(IMAGES)
    text = "".join((ROOT / name).read_text(encoding="utf-8") for name in documents(ROOT))

    files = {name: picture_doc.file_name(name, recipe) for name, recipe in recipes.items()}
    kept = {path.name for pattern in ("*.png", "*.gif", "*.webp") for path in IMAGES.glob(pattern)}
    assert {*files.values()} == kept
    assert [name for name in kept if (IMAGES / name).stat().st_size > 1_200_000] == []
    assert sorted(recipes) == sorted(picture_doc.read_frames(IMAGES))
    assert [name for name in files.values() if f"images/{name})" not in text] == []


@pytest.mark.parametrize(
    ("name", "printed"),
    [
        ("cases", "21"),
        ("stops", "84"),
        ("made", "83"),
        ("mean_cm", "0.18"),
        ("worst_cm", "3.5"),
        ("load_means_cm", "1.26, 0.97"),
        ("run_s", "497.0"),
        ("jerk_max_mps3", "0.74"),
        ("notch_changes_max_count", "15"),
    ],
)
def test_a_figure_is_written_between_its_comments(name: str, printed: str) -> None:
    text = f"mean <!-- figure law {name} -->?<!-- / --> cm, <!-- figure law stops --><!-- / -->"

    made = figure_doc.filled(text, {"law": KEPT}, "x.md")

    assert made == (
        f"mean <!-- figure law {name} -->{printed}<!-- / --> cm, "
        "<!-- figure law stops -->84<!-- / -->"
    )
    assert figure_doc.filled(made, {"law": KEPT}, "x.md") == made


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("<!-- figure other mean_cm -->1<!-- / -->", "x.md:2: no scenario other in "),
        ("<!-- figure law mean -->1<!-- / -->", "x.md:2: law has no figure mean; it has cases, "),
        ("<!-- figure law felt_jerk_1s_mps3 -->1<!-- / -->", "x.md:2: law has no figure felt_"),
        ("<!-- figure law mean_cm -->1", "x.md:2: write <!-- figure SCENARIO NAME -->"),
        ("<!-- figure law -->1<!-- / -->", "x.md:2: write <!-- figure SCENARIO NAME -->"),
    ],
)
def test_a_wrong_figure_is_reported_with_file_and_line(line: str, words: str) -> None:
    with pytest.raises(figure_doc.FigureError) as caught:
        figure_doc.filled(f"Text.\n{line}\n", {"law": KEPT}, "x.md")

    assert str(caught.value).startswith(words)


def test_text_in_a_block_is_no_figure() -> None:
    text = "```text\n<!-- figure law mean_cm -->\n<!-- measured: then -->\n```\n"

    assert figure_doc.filled(text, {}, "x.md") == text
    assert figure_doc.measured_tables(text) == ([], [])


TABLE: Final = "| figure | measured | bar |\n|---|---|---|\n| speed | 3 | 4 |\n| way | 5 | 6 |\n"


def test_a_table_of_measured_figures_names_date_machine_and_commit() -> None:
    mark = "<!-- measured: 2026-11-23, a machine, with two cores, daf1434 -->"

    ((made,), wrong) = figure_doc.measured_tables(f"{mark}\n\n{TABLE}")

    assert wrong == []
    assert (made.line, made.on, made.commit) == (1, "2026-11-23", "daf1434")
    assert made.machine == "a machine, with two cores"


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (TABLE, [3]),
        (f"Text.\n\n{TABLE}", [5]),
        (TABLE.replace("| 3 |", "| <!-- figure a b -->3<!-- / --> |"), [4]),
        (TABLE.replace("measured", "expected"), []),
        (f"<!-- measured: 2026-13-23, x, daf1434 -->\n{TABLE}", [1, 4]),
        (f"<!-- measured: yesterday -->\n{TABLE}", [1, 4]),
    ],
)
def test_the_check_detects_a_measured_figure_of_unknown_age(text: str, lines: list[int]) -> None:
    assert [line for line, _ in figure_doc.measured_tables(text)[1]] == lines


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[a]\nprobe = "x"\nlog = "y"\n', "a: needs probe, log, and either picture or page"),
        ('[a]\nprobe = "x"\nlog = "y"\npicture = "p"\npage = "q"\n', "either picture or page"),
        ('[a]\nprob = "x"\n', "a: unknown key prob"),
        ("[a\n", "pictures.toml: "),
    ],
)
def test_a_wrong_recipe_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / picture_doc.RECIPES).write_text(text, encoding="utf-8")

    with pytest.raises(picture_doc.PictureError) as caught:
        picture_doc.read_recipes(tmp_path)

    assert words in str(caught.value)
