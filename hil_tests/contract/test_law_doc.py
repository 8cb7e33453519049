"""The pages of the control laws agree with files, code and figures, and every law has one."""

import importlib
import re
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest

from metro_hil.report.law_figures import RESULTS, read_results
from metro_tools import law_doc
from vobc.ato.laws import STRATEGIES
from vobc.ato.settings.ato import Braking

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / law_doc.LAWS).glob("*.toml"))

LAW = """\
title = "A law that was made up"
summary = '''
It brakes when it has to,
and drives else.'''
source = "Author, 2013, section II."
settings = ["vobc.ato.settings.ato:Braking", "vobc.ato.settings.ato:PidGains"]

[[block]]
id = "profile"
label = 'The "profile"'
what = "a | speed over place"

[[block]]
id = "control"
label = "PID"
what = "an acceleration"

[[link]]
from = "profile"
to = "control"
label = "m/s"

[[equation]]
text = "a = k e"
source = "eq. 1"
code = "vobc.ato.motion.pid:Pid.step"

[[remark]]
text = "The paper forgets a sign."
"""
FIGURES = {
    "table-8-made_up": {
        "campaign": "florence",
        "title": "Brake delay of 1 s",
        "figures": {
            "cases": 21,
            "lacking": 0,
            "stops": 84,
            "missed": 1,
            "mean_m": 0.01234,
            "mean_low_m": 0.011,
            "mean_high_m": 0.014,
            "worst_m": -0.0456,
            "within_ratio": 0.988,
            "within_low_ratio": 0.935,
            "run_s": 95.04,
            "bound_m": 0.0712,
            "over_ratio": 0.083,
            "comfort": {"commanded_accel_max_mps2": 0.79, "felt_jerk_2hz_mps3": 0.67},
        },
    }
}


def page(text: str = LAW, figures: dict[str, Any] | None = None) -> str:
    return law_doc.document("made_up", tomllib.loads(text), figures or {})


def test_the_committed_pages_are_current() -> None:
    assert law_doc.main(["--check", str(ROOT)]) == 0, (
        "run python -m metro_tools.law_doc in the project's folder"
    )


def test_every_law_has_a_page_and_every_page_a_law() -> None:
    laws = {path.stem for path in PAGES}

    assert laws == set(STRATEGIES)


def test_every_name_on_a_page_exists_and_every_equation_has_a_source() -> None:
    for table in map(law_doc.read, PAGES):
        for code in [*table["settings"], *(equation["code"] for equation in table["equation"])]:
            module, _, names = code.partition(":")
            thing = importlib.import_module(module)
            for name in names.split("."):
                thing = getattr(thing, name)
            assert (ROOT / f"{module.replace('.', '/')}.py").is_file(), code
        assert all(equation["source"].strip() for equation in table["equation"])


def test_the_kept_figures_are_readable_and_belong_to_laws() -> None:
    kept = read_results((ROOT / "hil_tests" / "metro_hil" / RESULTS).read_text(encoding="utf-8"))

    assert set(kept) <= set(STRATEGIES)


def test_a_page_draws_blocks_and_links_and_explains_them() -> None:
    text = page()

    assert '```mermaid\nflowchart LR\n    profile["The #quot;profile#quot;"]\n' in text
    assert '    profile -- "m/s" --> control\n' in text
    assert '| The "profile" | a \\| speed over place |' in text
    assert "It brakes when it has to, and drives else.\n" in text
    assert (
        "```text\na = k e\n```\n\neq. 1. Code: [`Pid.step`](../../../vobc/ato/motion/pid.py).\n"
        in text
    )
    assert "- The paper forgets a sign.\n" in text


def test_parameters_come_from_the_settings_with_unit_default_and_text() -> None:
    text = page()

    assert f"| `decel_mps2` | m/s² | {Braking().decel_mps2} |  |" in text
    assert f"| `plateau_speed_mps` | m/s | {Braking().plateau_speed_mps:g} |  |" in text
    assert re.search(r"\| `least_decel_mps2` \| m/s² \| 0.03 \| Least .* \|", text)
    assert "Shape of a braking: constant deceleration" in text
    # A parameter without a default has a dash; units with a fraction are written out.
    assert "| `ki_per_s2` | 1/s² | – |  |" in text


def test_the_page_shows_the_kept_figures() -> None:
    row = page(figures=FIGURES).partition("## Figures")[2]

    for words in (
        "Brake delay of 1 s (`hil run table-8-made_up`) | 84, 1 missed | 1.23 [1.10–1.40] | -4.6 |",
        "| 7.1 | 98.8 % [93.5 %] | 95.0 | 8.3 | 0.79, – | –, –, 0.67 | – |",
    ):
        assert words in row
    assert "None is stored yet" in page()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('title = "A law', 'titel = "A law', "unknown key titel"),
        ('source = "eq. 1"', 'source = " "', "equation 1: source is not a text: ' '"),
        ('source = "eq. 1"\n', "", "equation 1: source is not a text: None"),
        (
            "Pid.step",
            "Pid.stop",
            "equation 1: code 'vobc.ato.motion.pid:Pid.stop': there is no stop",
        ),
        (
            "motion.pid:",
            "motion.pit:",
            "equation 1: code 'vobc.ato.motion.pit:Pid.step': No module named",
        ),
        ('to = "control"', 'to = "kontrol"', "link 1: to 'kontrol' is not the id of a block"),
        (
            'id = "control"',
            'id = "profile"',
            "block 2: id 'profile' is not a name, or is defined twice",
        ),
        (
            ":PidGains",
            ":MAX_DEAD_TIMES",
            "settings 2 'vobc.ato.settings.ato:MAX_DEAD_TIMES' is not a class",
        ),
        ("[[remark]]", "[[remrk]]", "unknown key remrk"),
    ],
)
def test_a_wrong_file_is_refused_with_file_and_key(old: str, new: str, words: str) -> None:
    with pytest.raises(law_doc.LawDocError) as caught:
        page(LAW.replace(old, new, 1))

    assert words in str(caught.value)
    assert str(caught.value).startswith("docs/reference/laws/made_up.toml: ")


def test_the_check_fails_for_any_other_text(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    laws = tmp_path / law_doc.LAWS
    laws.mkdir(parents=True)
    results = tmp_path / law_doc.RESULTS
    results.parent.mkdir(parents=True)
    shutil.copy(ROOT / law_doc.RESULTS, results)
    (laws / "made_up.toml").write_text(LAW, encoding="utf-8")

    assert law_doc.main(["--check", str(tmp_path)]) == 1
    assert law_doc.main([str(tmp_path)]) == 0
    assert law_doc.main(["--check", str(tmp_path)]) == 0
    assert (laws / "made_up.md").read_text(encoding="utf-8") == page()

    (laws / "made_up.toml").write_text("title = ", encoding="utf-8")
    assert law_doc.main(["--check", str(tmp_path)]) == 2
    assert "not TOML" in capsys.readouterr().err
