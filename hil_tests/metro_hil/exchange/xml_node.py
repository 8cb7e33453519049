"""Elements of an XML file, with the place that messages name."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from firmware_py.settings import SettingsError, text_of

DOCTYPE: Final = "<!DOCTYPE"
"""Begin of declarations that expand to any size; no file of a known format has one."""


@dataclass(frozen=True, slots=True)
class XmlNode:
    """One element of an XML file; names are those without namespace."""

    source: str
    element: ElementTree.Element
    parent: str = ""
    """Text that names the nearest element around it that has an id."""

    @property
    def tag(self) -> str:
        """Name without namespace."""
        return self.element.tag.rpartition("}")[2]

    @property
    def place(self) -> str:
        """Text that names this element in messages."""
        name = self.element.get("id")
        if name is not None:
            return f"{self.tag} {name!r}"
        return f"{self.parent}: {self.tag}" if self.parent else self.tag

    def error(self, text: str) -> SettingsError:
        """An error that names file and element."""
        return SettingsError(f"{self.source}: {self.place}: {text}")

    def all(self, *path: str) -> Iterator["XmlNode"]:
        """Elements along a path of names, below this one."""
        if not path:
            yield self
            return
        for child in self.element:
            node = XmlNode(self.source, child, self.place)
            if isinstance(child.tag, str) and node.tag == path[0]:
                yield from node.all(*path[1:])

    def first(self, *path: str) -> "XmlNode | None":
        """The first element along a path of names, or None."""
        return next(self.all(*path), None)

    def text(self, name: str) -> str | None:
        """An attribute, or None."""
        return self.element.get(name)

    def need(self, name: str, hint: str) -> str:
        """An attribute. Raises SettingsError with the hint if it is missing or empty."""
        text = self.element.get(name)
        if not text:
            raise self.error(f"has no {name!r}; {hint}")
        return text

    def number(self, name: str, factor: float = 1.0) -> float | None:
        """An attribute as a finite number times `factor`, or None. Raises SettingsError."""
        text = self.element.get(name)
        if text is None:
            return None
        try:
            number = float(text) * factor
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise self.error(f"{name}: {text!r} is not a finite number")
        return number

    def name(self) -> str:
        """The name of the object: its `name`, its designator, or its id."""
        for path, key in (("name", "name"), ("designator", "entry")):
            node = self.first(path)
            if node is not None and node.text(key):
                return node.need(key, "").strip()
        return self.text("id") or self.tag


def is_xml(text: str) -> bool:
    """Whether a text looks like XML."""
    return text.lstrip("\ufeff \t\r\n").startswith("<")


def read_xml(path: Path) -> XmlNode:
    """Read an XML file. Raises SettingsError."""
    text = text_of(path)
    if DOCTYPE in text:
        raise SettingsError(f"{path}: has a {DOCTYPE[2:]}, which railML has not; remove it")
    try:
        # Without a document type there is no entity to resolve.
        return XmlNode(str(path), ElementTree.fromstring(text.encode()))  # noqa: S314
    except ElementTree.ParseError as error:
        raise SettingsError(f"{path}: not XML: {error}") from error
