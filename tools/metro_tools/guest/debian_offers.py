"""Packages pinned by version and checksum, and the versions that a mirror offers. Pure."""

from dataclasses import dataclass
from typing import Final

from metro_tools.guest.plan import NoKernelError


@dataclass(frozen=True, slots=True)
class Package:
    """One version of a Debian package for amd64."""

    name: str
    version: str
    sha256: str


PINNED: Final = (
    Package(
        "user-mode-linux",
        "7.2um1",
        "f947c9244fd79d481299df2ad68961f6b3b7703bff38c4b0e726f861161da62c",
    ),
    Package("libc6", "2.43-7", "5c71715c51103beb4fbba9fe9f8dff604af6610dfa71c70bff342f54a7860803"),
)
"""Packages of Debian unstable: the kernel that boots on every processor tried so far, and its C
library."""


def offered(name: str, text: str) -> Package:
    """Return the package that the output of `apt-cache show` describes first.

    Raises:
        NoKernelError: the output describes none.
    """
    fields: dict[str, str] = {}
    for line in text.splitlines():
        if not line.strip() and fields:
            break
        key, colon, value = line.partition(":")
        if colon and not line[:1].isspace():
            fields[key] = value.strip()
    try:
        return Package(name, fields["Version"], fields["SHA256"].lower())
    except KeyError as error:
        raise NoKernelError(
            f"the mirror's index has no {error.args[0]} of the package {name}"
        ) from None


def settle(pinned: Package, offer: Package) -> tuple[Package, str]:
    """Return the package to use, and a remark unless it is the pinned one.

    Debian unstable keeps only one version of a package. When the pinned one is gone, its successor
    is authentic, too: the signed index contains its checksum.

    Raises:
        NoKernelError: the index has another checksum for the pinned version.
    """
    if offer.version != pinned.version:
        return offer, (
            f"the mirror has {offer.name} {offer.version} instead of the tested {pinned.version}; "
            f"using it, SHA-256 {offer.sha256} by the signed index"
        )
    if offer.sha256 != pinned.sha256:
        raise NoKernelError(
            f"the mirror's index states SHA-256 {offer.sha256} for {offer.name} {offer.version}, "
            f"but that version has {pinned.sha256}; use another mirror"
        )
    return pinned, ""


def sources_line(index_targets: str, keyring: str | None) -> str:
    """Return the sources.list line of Debian unstable on the mirror that this machine uses.

    Args:
        index_targets: addresses of the machine's repositories, one a line. The first address of the
            Debian archive is used; without any it is Debian's own.
        keyring: file with Debian's keys; None: the keys that the machine trusts.
    """
    mirrors = [line.strip() for line in index_targets.splitlines()]
    mirror = next((m for m in mirrors if m.rstrip("/").endswith("/debian")), DEBIAN_MIRROR)
    signed_by = f"[signed-by={keyring}] " if keyring else ""
    return f"deb {signed_by}{mirror} sid main\n"


DEBIAN_MIRROR: Final = "http://deb.debian.org/debian/"
