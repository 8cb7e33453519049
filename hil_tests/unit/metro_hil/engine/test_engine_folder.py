"""The campaign's folder: found by its name, complete before a run, and trusted if intact."""

import os
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.engine.folder import (
    MANIFEST,
    CampaignFolder,
    CampaignPlan,
    find_folder,
    folder_name,
    folders,
    make_folder,
)
from metro_hil.engine.trial_runner import trial_cases
from metro_hil.model.case import Case


def plan(
    cases: tuple[Case, ...] = trial_cases(3), name: str = "trial", **files: str
) -> CampaignPlan:
    return CampaignPlan(name=name, cases=cases, files=files, options={"keep": 1})


def test_cases_and_files_are_read_back_unchanged(tmp_path: Path) -> None:
    folder = make_folder(plan(line="a = 1\n"), root=tmp_path)

    assert folder.cases() == trial_cases(3)
    assert folder.files()["line"].read_text() == "a = 1\n"
    assert folder.files()["line"].is_absolute()
    assert folder.manifest().cases == 3
    assert not folder.journal_path.exists()


def test_files_with_the_same_name_do_not_collide(tmp_path: Path) -> None:
    both = CampaignPlan(
        name="x", cases=trial_cases(1), files={"a/l.toml": "1", "b/l.toml": "2"}, options={}
    )

    files = make_folder(both, root=tmp_path).files()

    assert [files[name].read_text() for name in ("a/l.toml", "b/l.toml")] == ["1", "2"]


def test_two_campaigns_of_the_same_second_have_separate_folders(tmp_path: Path) -> None:
    made = {make_folder(plan(), root=tmp_path).path for _ in range(3)}

    assert len(made) == 3
    assert {folder.path for folder in folders(tmp_path)} == made


def test_a_campaign_is_found_by_name_prefix_path_or_as_the_last(tmp_path: Path) -> None:
    first = make_folder(plan(name="one"), root=tmp_path)
    second = make_folder(plan(name="two"), root=tmp_path)
    os.utime(first.manifest_path, ns=(1, 1))

    assert find_folder(None, tmp_path) == second
    assert find_folder(str(first.path), tmp_path) == first
    assert find_folder(first.path.name, tmp_path) == first
    assert find_folder(first.path.name[:-1], tmp_path) == first


def test_the_name_of_a_campaign_means_its_last_run(tmp_path: Path) -> None:
    first = make_folder(plan(name="one"), out=str(tmp_path / "a"))
    second = make_folder(plan(name="one"), out=str(tmp_path / "b"))
    make_folder(plan(name="two"), out=str(tmp_path / "c"))
    os.utime(first.manifest_path, ns=(1, 1))

    assert find_folder("one", tmp_path) == second


def test_an_unknown_or_ambiguous_name_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    made = make_folder(plan(name="one"), root=tmp_path)
    make_folder(plan(name="one"), root=tmp_path)

    with pytest.raises(UsageError, match="more than one campaign"):
        find_folder(made.path.name[:8], tmp_path)
    with pytest.raises(UsageError, match="nothing-like-it"):
        find_folder("nothing-like-it", tmp_path)
    with pytest.raises(UsageError, match="hil run"):
        find_folder(None, tmp_path / "empty")


def test_a_full_name_counts_though_another_begins_with_it(tmp_path: Path) -> None:
    made = make_folder(plan(), out=str(tmp_path / "a"))
    make_folder(plan(), out=str(tmp_path / "a_2"))

    assert find_folder("a", tmp_path) == made


def test_a_folder_with_content_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")

    with pytest.raises(UsageError, match="not empty"):
        make_folder(plan(), out=str(tmp_path))

    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_folder_without_a_manifest_has_no_campaign(tmp_path: Path) -> None:
    folder = make_folder(plan(), root=tmp_path)
    folder.manifest_path.unlink()

    assert folders(tmp_path) == []


@pytest.mark.parametrize("value", [float("inf"), float("nan")])
def test_a_value_that_json_would_lose_is_refused_with_its_case(
    value: float, tmp_path: Path
) -> None:
    case = msgspec.structs.replace(trial_cases(1)[0], faults=({"kind": "x", "end_s": value},))

    with pytest.raises(UsageError, match="trial/0000-s1"):
        make_folder(plan((case,)), root=tmp_path)


def test_no_case_and_doubled_cases_are_refused(tmp_path: Path) -> None:
    (case,) = trial_cases(1)

    with pytest.raises(UsageError, match="no case"):
        make_folder(plan(()), root=tmp_path)
    with pytest.raises(UsageError, match="two cases"):
        make_folder(plan((case, msgspec.structs.replace(case, index=1))), root=tmp_path)


def test_changed_cases_or_files_are_not_run(tmp_path: Path) -> None:
    folder = make_folder(plan(line="a = 1\n"), root=tmp_path)
    folder.files()["line"].write_text("a = 2\n")
    with folder.cases_path.open("ab") as file:
        file.write(msgspec.json.encode(trial_cases(4)[3]) + b"\n")

    with pytest.raises(EngineError, match="changed since the campaign began"):
        folder.files()
    with pytest.raises(EngineError, match=f"not the cases that {MANIFEST} names"):
        folder.cases()


def test_the_fingerprint_distinguishes_campaigns_and_recognises_a_copy(tmp_path: Path) -> None:
    def mark(cases: tuple[Case, ...], **files: str) -> str:
        return make_folder(plan(cases, **files), root=tmp_path).manifest().fingerprint

    marks = [mark(trial_cases(3)), mark(trial_cases(2)), mark(trial_cases(3), line="a = 1")]

    assert len(set(marks)) == 3
    assert mark(trial_cases(3)) == marks[0]


@given(st.text(max_size=200), st.text(max_size=200))
def test_every_text_has_a_unique_folder_name(one: str, other: str) -> None:
    names = {folder_name(one), folder_name(other)}

    assert (len(names) == 1) is (one == other)
    for name in names:
        assert name not in ("", ".", "..")
        assert "/" not in name
        assert len(name.encode()) <= 255


def test_the_id_of_a_case_gives_the_folder_of_its_logs(tmp_path: Path) -> None:
    kept = CampaignFolder(tmp_path).kept("overspeed/0003-s1").path

    assert kept == tmp_path / "cases" / "overspeed" / "0003-s1"


def test_no_id_leads_out_of_the_folder(tmp_path: Path) -> None:
    for name in ("../../x", "/etc/x", "a/../../x", ".", ".."):
        assert tmp_path / "cases" in CampaignFolder(tmp_path).kept(name).path.parents
        assert ".." not in CampaignFolder(tmp_path).kept(name).path.parts
