"""Reads dates in the heads of text logs, in the languages of logging programs."""

import re
from typing import Final

from canlog.formats.text import date_ns

CLOCK: Final = re.compile(r"(?<!\d)(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?(?!\d)")
YEAR_FIRST: Final = re.compile(r"(?<!\d)(\d{4})[-/.年]\s?(\d{1,2})[-/.月]\s?(\d{1,2})日?(?!\d)")
DAY_FIRST: Final = re.compile(r"(?<!\d)(\d{1,2})[.:](\d{1,2})[.:](\d{4})(?!\d)")
YEAR: Final = re.compile(r"(?<!\d)(\d{4})年?(?!\d)")
DAY: Final = re.compile(r"(?<![\d:.])(\d{1,2})日?[.,]?(?![\d:月])")
EAST_ASIAN_MONTH: Final = re.compile(r"(\d{1,2})\s?[月월]")
BEFORE_NOON: Final = ("am", "a.m.", "上午", "午前", "오전", "vorm.")
AFTER_NOON: Final = ("pm", "p.m.", "下午", "午後", "오후", "nachm.")
LEGACY: Final = ("gb18030", "cp932", "cp949", "big5")
"""Encodings of East Asian programs; the first one that gives a readable date wins."""
MONTHS: Final = {
    name: number
    for number, names in enumerate(
        (
            "jan gen ene 一月",
            "feb fév fev 二月",
            "mar mär mrz maa 三月",
            "apr avr abr 四月",
            "may mai mei mag 五月",
            "jun juin giu 六月",
            "jul juil lug 七月",
            "aug aoû aou ago 八月",
            "sep set 九月",
            "oct okt ott out 十月",
            "nov 十一月",
            "dec dez déc dic 十二月",
        ),
        1,
    )
    for name in names.split()
}


def instant_ns(text: str) -> int | None:
    """Return nanoseconds since 1970 of a date with a time of day, in any usual order and language.

    An hour of 0 or above 12 is on the 24-hour clock, even beside AM or PM. It returns None for a
    text without a date, or if day and month are ambiguous.
    """
    for each in (text, *_decoded(text)):
        found = _instant_ns(each)
        if found is not None:
            return found
    return None


def _decoded(text: str) -> list[str]:
    """Decode the same bytes in other encodings, if the text was read as Latin-1."""
    try:
        raw = text.encode("latin-1")
    except UnicodeEncodeError:
        return []
    return [] if raw.isascii() else [raw.decode(each, "ignore") for each in LEGACY]


def _instant_ns(text: str) -> int | None:
    clock = CLOCK.search(text)
    if clock is None:
        return None
    rest = f"{text[: clock.start()]} {text[clock.end() :]}".lower()
    words = rest.replace(",", " ").split()
    hour = int(clock[1])
    if 0 < hour <= 12:
        after = any(word in AFTER_NOON for word in words)
        before = any(word in BEFORE_NOON for word in words)
        hour = hour % 12 + 12 * after if after or before else hour
    day = _day(rest, words)
    if day is None:
        return None
    fraction = f".{clock[4]}" if clock[4] else ""
    return date_ns(*day, f"{hour:02d}:{clock[2]}:{clock[3]}{fraction}")


def _day(rest: str, words: list[str]) -> tuple[int, int, int] | None:
    """Return year, month and day."""
    if (found := YEAR_FIRST.search(rest)) is not None:
        return int(found[1]), int(found[2]), int(found[3])
    if (found := DAY_FIRST.search(rest)) is not None:
        return int(found[3]), int(found[2]), int(found[1])
    year = YEAR.search(rest)
    if year is None:
        return None
    rest = f"{rest[: year.start()]} {rest[year.end() :]}"
    month, rest = _month(rest, words)
    day = DAY.search(rest)
    return None if month is None or day is None else (int(year[1]), month, int(day[1]))


def _month(rest: str, words: list[str]) -> tuple[int | None, str]:
    """Return the month, and the text without it if it was a number."""
    found = EAST_ASIAN_MONTH.search(rest)
    if found is not None:
        return int(found[1]), rest.replace(found[0], " ", 1)
    # French "mar." is Tuesday and stands before the month, so the last name counts.
    for word in reversed(words):
        name = word.rstrip(".")
        for length in (4, 3):
            if name[:length] in MONTHS:
                return MONTHS[name[:length]], rest
    return None, rest
