"""Credentials of a program on a secured line: certificate, safety-code key, session settings."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from firmware_py.settings import SettingsError

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

NS_PER_S: Final = 1_000_000_000
ADVICE: Final = "make new ones with `vobc demo-ca`"


@dataclass(frozen=True, slots=True)
class Credentials:
    settings: str
    """Session settings for zenoh in JSON5."""
    line_keys: str
    """Keys of the safety codes, as in the file `line.key`."""
    files: tuple[Path, ...] = ()
    """Certificate and private key, which may be renewed while the program runs."""
    key_path: Path | None = None
    """The file with the keys of the safety codes, which may change while the program runs."""


def load_credentials(
    folder: Path | str, name: str, epoch_ns: int, *, listens: bool = False
) -> Credentials:
    """Load the credentials of the program `name` from a folder of `vobc demo-ca` or of another
    authority.

    Raises SettingsError that names the file, for a file that is missing, expired, not valid yet, of
    another name, role or authority. A session would only fail without giving the reason.

    Args:
        listens: the program is the wayside's router, to which the others connect.
    """
    folder = Path(folder)
    authority = _certificate(folder / "ca.pem", epoch_ns)
    path = folder / f"{name}.pem"
    own = _certificate(path, epoch_ns)
    if f"CN={name}" not in own.subject.rfc4514_string().split(","):
        raise SettingsError(f"{path}: it is of {own.subject.rfc4514_string()}, not of {name}")
    try:
        own.verify_directly_issued_by(authority)
    except Exception as error:  # The library raises various exceptions for a damaged signature.
        raise SettingsError(f"{path}: not issued by {folder / 'ca.pem'}; {ADVICE}") from error
    _check_role(path, own, listens=listens)
    key = folder / f"{name}.key"
    _text(key)
    settings, line_key = _text(folder / f"{name}.json5"), folder / "line.key"
    return Credentials(settings, _text(line_key), (path, key), line_key)


def load_arbiter_keys(folder: Path | str, arbiters: int) -> dict[int, bytes]:
    """Load the public keys by which trains check the grants of arbiters 1 to `arbiters`.

    Raises SettingsError that names the file.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    found = {}
    for number in range(1, arbiters + 1):
        path = Path(folder) / f"grants{number}.pub"
        key = _ed25519(path, load_pem_public_key)
        if not isinstance(key, Ed25519PublicKey):
            raise SettingsError(f"{path}: no public Ed25519 key; {ADVICE}")
        found[number] = key.public_bytes_raw()
    return found


def load_arbiter_signing_keys(
    folder: Path | str, arbiters: Iterable[int]
) -> dict[int, "Ed25519PrivateKey"]:
    """Load the private keys with which the arbiters of these numbers sign. Raises SettingsError."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    found = {}
    for number in arbiters:
        path = Path(folder) / f"grants{number}.key"
        key = _ed25519(path, lambda pem: load_pem_private_key(pem, None))
        if not isinstance(key, Ed25519PrivateKey):
            raise SettingsError(f"{path}: no private Ed25519 key; {ADVICE}")
        found[number] = key
    return found


def _ed25519(path: Path, load: Callable[[bytes], object]) -> object:
    try:
        return load(_text(path).encode())
    except (ValueError, TypeError):
        return None


def _check_role(path: Path, own: "x509.Certificate", *, listens: bool) -> None:
    """Refuse a certificate for another role or for both, which lets a train pose as the wayside."""
    from cryptography import x509
    from cryptography.x509.oid import ExtendedKeyUsageOID

    try:
        usages = {*own.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value}
    except x509.ExtensionNotFound:
        usages = set()
    listening, connecting = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
    if usages != {listening if listens else connecting}:
        role = "the wayside alone" if listens else "programs that connect to the wayside"
        raise SettingsError(f"{path}: it is not for the role of {role}; {ADVICE}")


def _certificate(path: Path, epoch_ns: int) -> "x509.Certificate":
    # Imported here because only a secured line uses it.
    from cryptography import x509

    text = _text(path)
    try:
        found = x509.load_pem_x509_certificate(text.encode())
    except ValueError as error:
        raise SettingsError(f"{path}: no certificate: {error}") from error
    now_s = epoch_ns / NS_PER_S
    since, until = found.not_valid_before_utc, found.not_valid_after_utc
    if now_s > until.timestamp():
        raise SettingsError(f"{path}: expired on {until:%Y-%m-%d %H:%M} UTC; {ADVICE}")
    if now_s < since.timestamp():
        raise SettingsError(
            f"{path}: not valid before {since:%Y-%m-%d %H:%M} UTC; is the clock wrong?"
        )
    return found


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text"
        raise SettingsError(f"{path}: cannot be read: {reason}; {ADVICE}") from error
