"""The documents of the project in reading order."""

import re
from collections import deque
from pathlib import Path
from typing import Final

README: Final = "README.md"
LINK: Final = re.compile(r"\]\(([^)#\s]+\.md)(?:#[^)]*)?\)")


def documents(root: Path) -> list[str]:
    """Return README.md, then the documents it links to, then those they link to, then the rest by
    name.

    Each is given by its path below the project's folder.
    """
    names = sorted(path.relative_to(root).as_posix() for path in root.glob("docs/**/*.md"))
    left = [README, *names]
    found: list[str] = []
    waiting = deque(left[:1])
    while waiting:
        name = waiting.popleft()
        if name not in left:
            continue
        left.remove(name)
        found.append(name)
        waiting += _links(root, name)
    return found + left


def _links(root: Path, name: str) -> list[str]:
    here = (root / name).parent
    linked = [here / link for link in LINK.findall((root / name).read_text(encoding="utf-8"))]
    inside = [path.resolve() for path in linked if path.resolve().is_relative_to(root.resolve())]
    return [path.relative_to(root.resolve()).as_posix() for path in inside]
