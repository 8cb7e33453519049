"""The filter of the frame table: words that must all match, with the page's syntax."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fnmatch import translate
from typing import Any, Final

import numpy as np

from canlog.damage import LogError
from canlog.database import MessageSpec
from canlog.frames import KEY_EXTENDED, Bools
from canlog.reader import Log
from canlog.views.packed import KeyGroup, Ordered

COMPARED: Final = re.compile(r"([A-Za-z_][\w.:@-]*)(>=|<=|==|!=|=|>|<)(.+)")
BARE_ID: Final = re.compile(r"[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}")
COMPARISONS: Final[Mapping[str, Callable[[Any, Any], Any]]] = {
    ">": np.greater,
    "<": np.less,
    ">=": np.greater_equal,
    "<=": np.less_equal,
    "=": np.equal,
    "==": np.equal,
    "!=": np.not_equal,
}


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """The frames of one message."""

    group: KeyGroup
    name: str
    spec: MessageSpec | None


Term = Callable[[Subject], "bool | Bools"]
"""Decides whether all, none, or which frames of a message pass."""


def passing(log: Log, ordered: Ordered, subjects: Iterable[Subject], text: str) -> Any:
    """Return the rows, in order of time, that pass; None for all.

    Raises:
        LogError: for a word that matches no message or signal of the log.
    """
    subjects = tuple(subjects)
    terms = [_term(log, subjects, word) for word in text.split()]
    if not terms:
        return None
    keep = np.zeros(len(ordered.frames), np.bool_)
    for subject in subjects:
        mask: bool | Bools = True
        for term in terms:
            mask = np.logical_and(mask, term(subject))
        keep[subject.group.rows] = mask
    return np.flatnonzero(keep)


def _term(log: Log, subjects: tuple[Subject, ...], word: str) -> Term:
    if word.startswith("-") and len(word) > 1:
        inner = _term(log, subjects, word[1:])
        return lambda subject: np.logical_not(inner(subject))
    compared = COMPARED.fullmatch(word)
    if compared is not None:
        return _comparison(log, subjects, *compared.groups())
    if word.startswith("@"):
        return lambda subject: any(alike(word[1:], name) for name in _senders(subject))
    digits = word[2:] if word.lower().startswith("0x") else word
    if digits != word or BARE_ID.fullmatch(word):
        try:
            wanted = int(digits, 16)
        except ValueError as error:
            raise LogError(f"{word} is no identifier") from error
        return lambda subject: subject.group.key & ~KEY_EXTENDED == wanted
    if not any(alike(word, subject.name) for subject in subjects):
        raise LogError(f"no message {word}")
    return lambda subject: alike(word, subject.name)


def _senders(subject: Subject) -> tuple[str, ...]:
    return subject.spec.senders if subject.spec is not None else ()


def _comparison(log: Log, subjects: tuple[Subject, ...], name: str, sign: str, text: str) -> Term:
    first, dot, second = name.partition(".")
    pattern, signal = (first, second) if dot else ("", first)

    def has(subject: Subject) -> bool:
        names = {each.name for each in subject.spec.signals} if subject.spec is not None else set()
        return (not dot or alike(pattern, subject.name)) and signal in names

    having = [subject for subject in subjects if has(subject)]
    if not having:
        raise LogError(f"no signal {name}")
    number = _number(text)
    tables = {text for subject in having for text in _choices(subject, signal)}
    if number is None and text not in tables:
        raise LogError(f"{text} is neither a number nor a value of {name}")
    compare = COMPARISONS[sign]

    def term(subject: Subject) -> "bool | Bools":
        if not has(subject) or subject.spec is None:
            return False
        group = subject.group
        table = log.groups.table(subject.spec, group.channel, (group.key,))
        if number is not None:
            found = compare(np.asarray(table[signal], np.float64), number)
        else:
            raws = [
                raw for raw, label in subject.spec.signal(signal).choices.items() if label == text
            ]
            found = np.isin(table.raw(signal), np.array(raws, table.raw(signal).dtype))
            found = ~found if sign == "!=" else found
        held: Bools = found & table.valid(signal)
        return held[np.argsort(table.at_ns, kind="stable")]

    return term


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _choices(subject: Subject, signal: str) -> Iterable[str]:
    return subject.spec.signal(signal).choices.values() if subject.spec is not None else ()


def alike(pattern: str, name: str) -> bool:
    """Whether a text is part of a name, or a pattern for all of it; case is ignored."""
    if not any(sign in pattern for sign in "*?"):
        return pattern.lower() in name.lower()
    escaped = pattern.replace("[", "[[]")
    return re.fullmatch(translate(escaped), name, re.IGNORECASE) is not None
