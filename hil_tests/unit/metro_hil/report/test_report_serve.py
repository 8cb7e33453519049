"""`hil serve`: campaigns of a folder as they grow, fail and break; and its page in a browser."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest

from canlog.damage import LogError
from hil_tests.serving_rig import served
from metro_hil.cli.hil import main as hil
from metro_hil.engine.folder import CampaignFolder, CampaignPlan, make_folder
from metro_hil.engine.journal import JournalLine, encode_line
from metro_hil.model.case import Verdict
from metro_hil.report.campaign.ledger import join
from metro_hil.report.campaign.summary import summary_json
from metro_hil.report.campaign.tally import tally_measures, tally_monitors
from metro_hil.watch.campaign_server import CampaignServer
from metro_hil.watch.campaigns import FRESH_NS, Shelf, cases_of
from metro_tools.browser import Browser

CASES: Final = 60


def recorded(folder: Path, made: Any, results: int, *, finished: bool) -> CampaignFolder:
    """Write a campaign as `hil run` does: with that many results, and with a summary at the end."""
    plan = CampaignPlan(name="stops", cases=made.cases, files={}, options={})
    campaign = make_folder(plan, str(folder))
    lines = [encode_line(JournalLine(head=campaign.head()))]
    lines += [encode_line(JournalLine(result=each)) for each in made.results[:results]]
    campaign.journal_path.write_bytes(b"".join(lines))
    if finished:
        ledger = join(made.cases, made.results[:results], expected_cases=len(made.cases))
        tallies = tally_monitors(ledger), tally_measures(ledger)
        text = summary_json(made.info, ledger, *tallies, [])
        (folder / "summary.json").write_text(text)
    return campaign


def now_of(campaign: CampaignFolder) -> int:
    return campaign.journal_path.stat().st_mtime_ns


def test_a_finished_campaign_shows_its_summary(
    tmp_path: Path, campaign: Callable[..., Any]
) -> None:
    made = campaign(CASES)
    folder = recorded(tmp_path / "deep" / "a", made, CASES, finished=True)
    ledger = join(made.cases, made.results, expected_cases=CASES)

    (row,) = Shelf(tmp_path).look(now_of(folder))

    assert (row["path"], row["name"]) == ("deep/a", "stops")
    assert row["state"] == ("passed" if ledger.good else "failed")
    assert (row["cases"], row["done"], row["good"]) == (CASES, CASES, ledger.as_expected)
    assert {name: sum(pair) for name, pair in row["scenarios"].items()} == {
        name: len(entries) + sum(each.as_expected for each in entries)
        for name, entries in ledger.scenarios().items()
    }
    least = min(result.monitors[0].margin for result in made.results)
    assert row["margins"]["stops within 10 cm"][0] == pytest.approx(least, rel=1e-4)


def test_a_running_campaign_grows_and_names_its_failures(
    tmp_path: Path, campaign: Callable[..., Any]
) -> None:
    made = campaign(CASES)
    bad = [each.case_id for each in made.results if each.verdict.value == "fail"]
    folder = recorded(tmp_path / "a", made, 0, finished=False)
    shelf = Shelf(tmp_path)

    (empty,) = shelf.look(now_of(folder))
    seen = shelf.version
    shelf.look(now_of(folder))
    unchanged = shelf.version
    text = b"".join(encode_line(JournalLine(result=each)) for each in made.results)
    with folder.journal_path.open("ab") as journal:
        journal.write(text[:-7])
    os.utime(folder.journal_path, ns=(1, now_of(folder) + 1))
    (part,) = shelf.look(now_of(folder))
    with folder.journal_path.open("ab") as journal:
        journal.write(text[-7:])
    os.utime(folder.journal_path, ns=(1, now_of(folder) + 2))
    (whole,) = shelf.look(now_of(folder))
    (later,) = shelf.look(now_of(folder) + FRESH_NS)

    assert bad
    assert (empty["state"], empty["done"], seen) == ("running", 0, unchanged)
    assert (part["done"], part["cases"]) == (CASES - 1, CASES)
    assert whole["done"] == CASES
    assert [name for name, _ in whole["failures"]] == bad
    assert later["state"] == "unfinished"


def test_a_resumed_campaign_counts_again_and_a_removed_one_goes(
    tmp_path: Path, campaign: Callable[..., Any]
) -> None:
    made = campaign(CASES)
    folder = recorded(tmp_path / "a", made, CASES - 10, finished=True)
    shelf = Shelf(tmp_path)
    (before,) = shelf.look(now_of(folder))

    with folder.journal_path.open("ab") as journal:
        journal.write(b"".join(encode_line(JournalLine(result=r)) for r in made.results[-10:]))
    os.utime(folder.journal_path, ns=(1, now_of(folder) + 5 * 10**9))
    (after,) = shelf.look(now_of(folder))
    folder.manifest_path.unlink()

    assert (before["done"], after["done"]) == (CASES - 10, CASES)
    assert shelf.look(now_of(folder)) == []
    assert shelf.folder("a") is None


@pytest.mark.parametrize("name", ["campaign.json", "cases.jsonl", "summary.json"])
def test_a_damaged_campaign_is_named_and_hides_no_other(
    tmp_path: Path, campaign: Callable[..., Any], name: str
) -> None:
    made = campaign(CASES)
    recorded(tmp_path / "good", made, CASES, finished=True)
    broken = recorded(tmp_path / "broken", made, CASES, finished=name == "summary.json")
    (broken.path / name).write_text('{"name": 3')

    rows = {row["path"]: row for row in Shelf(tmp_path).look(now_of(broken))}

    assert rows["good"]["done"] == CASES
    assert rows["broken"]["state"] == "unreadable"
    assert name in rows["broken"]["problem"]


def test_the_cases_of_a_campaign_tell_where_they_failed(
    tmp_path: Path, campaign: Callable[..., Any]
) -> None:
    made = campaign(CASES)
    folder = recorded(tmp_path / "a", made, CASES - 1, finished=False)

    rows = cases_of(folder)

    assert [row["good"] for row in rows[:-1]] == [
        each.verdict.value == "pass" for each in made.results[:-1]
    ]
    assert rows[-1]["why"] == "no result came back"
    bad = next(row for row in rows if not row["good"])
    told = next(each for each in made.results if each.case_id == bad["id"])
    assert (bad["monitor"], bad["at_s"]) == ("stops within 10 cm", told.monitors[0].at_s)


def test_only_campaigns_and_cases_of_the_list_are_served(
    tmp_path: Path, campaign: Callable[..., Any]
) -> None:
    recorded(tmp_path / "root" / "a", campaign(CASES), CASES, finished=True)
    recorded(tmp_path / "outside", campaign(CASES), CASES, finished=True)
    server = CampaignServer(tmp_path / "root", now_ns=lambda: 0)
    server.answer("data", {})

    for path in ("../outside", "", "/etc", "a/../a"):
        with pytest.raises(LogError, match="no campaign of this folder"):
            server.answer("cases", {"path": path})
    with pytest.raises(LogError, match="no case of this campaign"):
        server.answer("case", {"path": "a", "id": "../../../outside"})
    with pytest.raises(LogError, match=r"report\.html"):
        server.answer("report", {"path": "a"})
    assert server.answer("secrets", {}) is None
    server._socket.close()


def test_the_page_shows_history_failures_and_differences(
    browser: Browser, tmp_path: Path, campaign: Callable[..., Any]
) -> None:
    made = campaign(CASES)
    good = [
        msgspec.structs.replace(each, verdict=Verdict.PASS, reason="", monitors=each.monitors[1:])
        for each in made.results
    ]
    recorded(tmp_path / "a", type(made)(made.info, made.cases, good), CASES, finished=True)
    os.utime(tmp_path / "a" / "campaign.json", ns=(1, 1))
    recorded(tmp_path / "b", made, CASES, finished=True)
    bad = [each.case_id for each in made.results if each.verdict.value == "fail"]

    with served(CampaignServer(tmp_path, now_ns=lambda: 0)) as address:
        browser.open(address)
        browser.wait("document.querySelectorAll('#rows tbody tr').length === 2")
        states = browser.run("[...document.querySelectorAll('.state')].map(e => e.textContent)")
        # The answer about the first one comes when the second one is open already.
        for state in ("passed", "failed"):
            browser.run(f"document.querySelector('#rows .state.{state}').closest('tr').click()")
        browser.wait(
            "document.querySelectorAll('#cases tbody tr').length && "
            "document.getElementById('detail-told').textContent.includes('as expected')"
        )
        widths = []
        for width in (320, 1600):
            browser.call(
                "Emulation.setDeviceMetricsOverride",
                width=width,
                height=900,
                deviceScaleFactor=1,
                mobile=False,
            )
            browser.settle()
            widths.append(browser.run("document.documentElement.scrollWidth"))
        listed = browser.run(
            "[...document.querySelectorAll('#cases tbody td:first-child')].map(e => e.textContent)"
        )
        changed = browser.run("document.querySelectorAll('#matrix .changed').length")
        difference = browser.text("#difference")
        browser.run("document.getElementById('filter').value = 'state:unfinished'; show()")
        filtered = browser.run("document.querySelectorAll('#rows tbody tr').length")
        browser.call(
            "Emulation.setDeviceMetricsOverride",
            width=1440,
            height=900,
            deviceScaleFactor=1,
            mobile=False,
        )

    assert sorted(states) == ["failed", "passed"]
    assert widths == [320, 1600]
    assert sorted(listed) == sorted(bad)
    assert changed == len({name.split("/")[0] for name in bad})
    assert "scenario" in difference
    assert filtered == 0
    assert not browser.log


def test_a_folder_that_is_not_there_gets_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert hil(["serve", "no/such/folder", "--no-browser"]) == 2

    said = capsys.readouterr().err
    assert said == (
        "hil: no/such/folder: no such folder; `hil run` makes campaigns below runs/hil\n"
    )


def test_the_first_line_of_the_page_is_the_folder(tmp_path: Path) -> None:
    hostile = tmp_path / "</script><b>"
    hostile.mkdir(parents=True)
    server = CampaignServer(hostile, now_ns=lambda: 0)

    found = server.answer("", {})

    assert found is not None
    text = found[1].decode()
    assert "</script><b>" not in text
    assert json.dumps(str(hostile)).replace("<", "\\u003c") in text
    server._socket.close()
