"""`vobc demo-ca`: a certificate authority for demonstrations, with all files of a secured line."""

import argparse
import enum
import ipaddress
import re
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Self

import numpy as np
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from firmware_py.clock.clock import WallClock
from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from firmware_py.storage.whole_file import whole_file, write_whole
from firmware_py.trackdb.areas import load_areas
from firmware_py.trackdb.circuit import load_network
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_OK, EXIT_USAGE
from metro_hil.model.service import line_of_service, load_service
from zenoh_config.codec import KEY_NUMBERS, parsed_keys
from zenoh_config.keys import line_chunk
from zenoh_config.secured import (
    CLIENT_NAMES,
    WAYSIDE_NAME,
    client_settings,
    train_name,
    wayside_settings,
)
from zenoh_config.t2t import ARBITERS_MAX, ROSTER_MAX

LINE: Final = "loop"
AUTHORITY: Final = "demonstration authority"
EARLIER_S: Final = 300
"""Certificates are valid from this long ago, because other machines' clocks may be slow."""
AUTHORITY_DAYS: Final = 3650.0
"""Least validity of the authority, so that it can renew certificates for ten years."""
TRAINS: Final = 8
KEY_BYTES: Final = 32
DAY_S: Final = 86_400
PRIVATE_MODE: Final = 0o600
HOSTS: Final = ("localhost", "127.0.0.1")
LABEL: Final = r"[A-Za-z0-9](?:[A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
NAME: Final = re.compile(rf"{LABEL}(?:\.{LABEL})*")
NS_PER_S: Final = 1_000_000_000


class KeyStep(enum.StrEnum):
    """Steps of a change of the key of safety codes, in their order."""

    ADD = "add"
    USE = "use"
    DROP = "drop"


def main(words: Sequence[str]) -> int:
    """Run the command; exit code 2 for invalid options, 3 for a folder that cannot be written."""
    options = parser().parse_args(words)
    hosts, epoch_s = (*HOSTS, *options.host), WallClock().epoch_ns() // NS_PER_S
    try:
        line, paths = _names(options)
        if options.line_key is not None:
            return _change_line_key(options)
        if options.add or options.renew:
            return _change(options, line, paths, epoch_s)
        make(
            options.folder,
            line=line,
            trains=options.trains or TRAINS,
            days=options.days,
            hosts=hosts,
            epoch_s=epoch_s,
            paths=paths,
        )
    except SettingsError as error:
        return _complain(error, EXIT_USAGE)
    except OSError as error:
        return _complain(f"{options.folder}: {error.strerror}", EXIT_ENVIRONMENT)
    trains = options.trains or TRAINS
    print(f"{options.folder}: for the wayside's programs, supervision and {trains} trains,")
    print(f"{options.days:g} days; for demonstrations only: the authority's key lies beside it")
    if options.service is None:
        print(f"plant wayside --line {options.line} --secure {options.folder}")
    else:
        print(f"vobc line up --service {options.service} --secure {options.folder}")
    return EXIT_OK


def _names(options: argparse.Namespace) -> tuple[str, tuple[str, ...]]:
    """Return the names of the line, or of the network with its paths. Raises SettingsError."""
    if options.service is None:
        options.line = options.line or LINE
        return load_areas(options.line).name, ()
    if options.line is not None:
        raise SettingsError("--line: not with --service, whose file names its network")
    plan = load_service(options.service)
    name = load_network(line_of_service(options.service)).name
    return name, tuple(dict.fromkeys(each.path.line.name for each in plan))


def make(
    folder: Path,
    *,
    line: str,
    trains: int,
    days: float,
    hosts: Sequence[str],
    epoch_s: int,
    paths: Sequence[str] = (),
) -> None:
    """Write certificates, keys, session settings, and the keys of arbiters and safety codes.

    Args:
        paths: names of the paths, if `line` is the name of a network.

    Raises OSError, and SettingsError for a folder that is not empty.
    """
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.resolve()
    if (folder / "ca.pem").exists():
        raise SettingsError(
            f"{folder}/ca.pem: exists already; choose another folder, or --add or --renew"
        )
    if any(folder.iterdir()):
        raise SettingsError(f"{folder}: not empty; choose a new folder for the keys")
    authority = DemoAuthority.new(epoch_s, max(days, AUTHORITY_DAYS))
    span_s = (epoch_s - EARLIER_S, epoch_s + round(days * DAY_S))
    _write_key(folder / "ca.key", authority.key)
    names = [train_name(n + 1) for n in range(trains)]
    for name in (WAYSIDE_NAME, *CLIENT_NAMES, *names):
        authority.issue(folder, name, hosts, span_s)
    _write_settings(folder, line, paths, names)
    for number in range(1, ARBITERS_MAX + 1):
        _write_arbiter(folder, number)
    _write_line_keys(folder, [(0, secrets.token_bytes(KEY_BYTES))])
    pem = authority.certificate.public_bytes(serialization.Encoding.PEM)
    (folder / "ca.pem").write_bytes(pem)


def _change(options: argparse.Namespace, line: str, paths: Sequence[str], epoch_s: int) -> int:
    """Add trains to a line, or renew certificates. Raises SettingsError and OSError."""
    folder = options.folder.resolve()
    if options.trains is not None:
        raise SettingsError("--trains: not with --add or --renew, which name each train")
    authority = DemoAuthority.load(folder)
    known = {path.stem for path in folder.glob("*.pem")} - {"ca"}
    for name in options.add:
        if name in known or not re.fullmatch(r"T[1-9][0-9]{0,4}", name):
            words = "it exists already; --renew makes a new one" if name in known else "not a train"
            raise SettingsError(f"--add {name}: {words}")
    for name in options.renew:
        if name not in known:
            hint = "--add makes that of a train, and a new folder has all others"
            raise SettingsError(f"--renew {name}: there is no {folder / name}.pem; {hint}")
    settings = folder / f"{WAYSIDE_NAME}.json5"
    text = settings.read_text(encoding="utf-8")
    if any(f'"m/{line_chunk(name)}/' not in text for name in (line, *paths)):
        asked = f"--service {options.service}" if paths else f"--line {options.line}"
        raise SettingsError(f"{asked}: {settings} is for another line")
    span_s = (epoch_s - EARLIER_S, epoch_s + round(options.days * DAY_S))
    until_s = authority.certificate.not_valid_after_utc.timestamp()
    if span_s[1] > until_s:
        raise SettingsError(
            f"--days {options.days:g}: longer than {folder}/ca.pem, which ends in "
            f"{(until_s - epoch_s) / DAY_S:.0f} days"
        )
    hosts = (*_hosts_of(folder / f"{WAYSIDE_NAME}.pem"), *options.host)
    for name in (*options.add, *options.renew):
        authority.issue(folder, name, hosts, span_s)
    if options.add:
        trains = known - {WAYSIDE_NAME, *CLIENT_NAMES}
        _write_settings(folder, line, paths, sorted({*trains, *options.add}))
    for name in options.add:
        print(f"{name}: added; the wayside admits it from its next start on")
    for name in options.renew:
        taken = (
            "it counts from its next start on"
            if name == WAYSIDE_NAME
            else "a running program takes it within seconds"
        )
        print(f"{name}: renewed for {options.days:g} days; {taken}")
    return EXIT_OK


def _change_line_key(options: argparse.Namespace) -> int:
    """Take one step of the change of the safety codes' key. Raises SettingsError and OSError."""
    if options.add or options.renew or options.trains is not None:
        raise SettingsError("--line-key: not with --add, --renew or --trains")
    folder, step = options.folder.resolve(), KeyStep(options.line_key)
    path = folder / "line.key"
    try:
        keys = parsed_keys(path.read_text(encoding="utf-8"))
    except OSError as error:
        words = f"{path}: {error.strerror}; was it made by `vobc demo-ca`?"
        raise SettingsError(words) from error
    except ValueError as error:
        raise SettingsError(f"{path}: {error}") from error
    if (step is KeyStep.ADD) is (len(keys) > 1):
        two = "there are two keys already; `use` the second or `drop` it"
        words = two if len(keys) > 1 else "there is only one key; `add` another one first"
        raise SettingsError(f"--line-key {step}: {path}: {words}")
    first = keys[0][0]
    if step is KeyStep.ADD:
        number = (first + 1) % KEY_NUMBERS
        keys.append((number, secrets.token_bytes(KEY_BYTES)))
        done, then = f"key {number} is accepted, key {first} is sent with", KeyStep.USE
    elif step is KeyStep.USE:
        keys.reverse()
        done, then = f"key {keys[0][0]} is sent with, key {first} is accepted", KeyStep.DROP
    else:
        done, then = f"key {first} is sent with, key {keys.pop()[0]} is refused", None
    _write_line_keys(folder, keys)
    print(f"line.key: {done}; running programs take it within seconds")
    if then is not None:
        print(f"next: --line-key {then}, when every host of the line has this file")
    return EXIT_OK


def _write_line_keys(folder: Path, keys: Sequence[tuple[int, bytes]]) -> None:
    """Write the keys of safety codes; the first one is to send with."""
    lines = [f"{number} {key.hex()}" if number else key.hex() for number, key in keys]
    with whole_file(folder / "line.key") as part:
        _write_private(part, ("\n".join(lines) + "\n").encode())


def _write_settings(folder: Path, line: str, paths: Sequence[str], trains: Sequence[str]) -> None:
    """Write the session settings of all programs; those of the wayside name every train."""
    numbers = [int(name.removeprefix("T")) for name in trains]
    texts = {WAYSIDE_NAME: wayside_settings(str(folder), line, numbers, paths=paths)}
    for name in (*CLIENT_NAMES, *trains):
        texts[name] = client_settings(str(folder), name)
    for name, text in texts.items():
        write_whole(folder / f"{name}.json5", text)


class DemoAuthority:
    """Issues certificates: the wayside's is for listening only, all others for connecting only."""

    def __init__(self, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
        self.key, self.certificate = key, certificate

    @classmethod
    def new(cls, epoch_s: int, days: float) -> Self:
        key, name = ec.generate_private_key(ec.SECP256R1()), _name(AUTHORITY)
        span_s = (epoch_s - EARLIER_S, epoch_s + round(days * DAY_S))
        builder = _builder(name, name, key, span_s)
        constraint = x509.BasicConstraints(ca=True, path_length=0)
        builder = builder.add_extension(constraint, critical=True)
        return cls(key, builder.sign(key, hashes.SHA256()))

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Raises SettingsError that names the file which cannot be used."""
        path = folder / "ca.key"
        try:
            key = serialization.load_pem_private_key(path.read_bytes(), None)
            path = folder / "ca.pem"
            certificate = x509.load_pem_x509_certificate(path.read_bytes())
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else "no key or certificate"
            raise SettingsError(f"{path}: {reason}; was it made by `vobc demo-ca`?") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise SettingsError(f"{folder / 'ca.key'}: not a key of `vobc demo-ca`")
        return cls(key, certificate)

    def issue(self, folder: Path, name: str, hosts: Sequence[str], span_s: tuple[int, int]) -> None:
        """Write key and certificate of one program. Raises OSError."""
        key, listens = ec.generate_private_key(ec.SECP256R1()), name == WAYSIDE_NAME
        builder = _builder(_name(name), self.certificate.subject, key, span_s)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
        usage = ExtendedKeyUsageOID.SERVER_AUTH if listens else ExtendedKeyUsageOID.CLIENT_AUTH
        builder = builder.add_extension(x509.ExtendedKeyUsage([usage]), True)
        if listens:
            names = x509.SubjectAlternativeName([_host(each) for each in hosts])
            builder = builder.add_extension(names, False)
        pem = builder.sign(self.key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
        _write_key(folder / f"{name}.key", key)
        write_whole(folder / f"{name}.pem", pem)


def _write_arbiter(folder: Path, number: int) -> None:
    """Write the key with which an arbiter signs its grants, and the public key for the trains."""
    key = ed25519.Ed25519PrivateKey.generate()
    _write_key(folder / f"grants{number}.key", key)
    public = key.public_key().public_bytes(
        serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
    )
    (folder / f"grants{number}.pub").write_bytes(public)


def _hosts_of(path: Path) -> list[str]:
    """Return the hosts in the wayside's certificate. Raises SettingsError."""
    try:
        found = x509.load_pem_x509_certificate(path.read_bytes())
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (OSError, ValueError, x509.ExtensionNotFound) as error:
        raise SettingsError(f"{path}: no certificate of a wayside with its hosts") from error
    return [str(each.value) for each in names]


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    span_s: tuple[int, int],
) -> x509.CertificateBuilder:
    since, until = (np.datetime64(each, "s").astype(object) for each in span_s)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(since)
        .not_valid_after(until)
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _host(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def _write_key(path: Path, key: ec.EllipticCurvePrivateKey | ed25519.Ed25519PrivateKey) -> None:
    coded = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    _write_private(path, coded)


def _write_private(path: Path, content: bytes) -> None:
    path.touch(PRIVATE_MODE)
    path.write_bytes(content)


def parser() -> argparse.ArgumentParser:
    """Return the parser of `vobc demo-ca`."""
    top = CommandParser(prog="vobc demo-ca", description=__doc__)
    top.add_argument(
        "folder",
        type=Path,
        metavar="FOLDER",
        help="a new folder, or that of a line with --add, --renew or --line-key",
    )
    top.add_argument("--line", metavar="NAME|FILE", help=f"default: {LINE}")
    top.add_argument(
        "--service",
        metavar="FILE",
        help="instead of a line: the network of this service, with all paths of its trips",
    )
    top.add_argument("--trains", type=_trains, metavar="N", help=f"default: {TRAINS}")
    top.add_argument(
        "--add",
        action="append",
        default=[],
        metavar="TRAIN",
        help="add a train, such as T9, to a folder that exists; may be given several times",
    )
    top.add_argument(
        "--renew",
        action="append",
        default=[],
        metavar="NAME",
        help="make a new key and certificate, such as for T3, wayside or arbiter2; likewise",
    )
    top.add_argument(
        "--line-key",
        choices=[each.value for each in KeyStep],
        help="change the key of safety codes while the line runs: add a new key that all accept, "
        "use it to send, drop the key before it",
    )
    top.add_argument("--days", type=_days, default=30.0, help="validity in days; default: 30")
    top.add_argument(
        "--host",
        type=_host_name,
        action="append",
        default=[],
        metavar="NAME|ADDRESS",
        help="host of the wayside in addition to this machine; may be given several times",
    )
    return top


def _host_name(text: str) -> str:
    """Parse an address or a valid host name (RFC 1123)."""
    if NAME.fullmatch(text) is None:
        try:
            ipaddress.ip_address(text)
        except ValueError:
            message = f"{text!r} is neither the name of a host nor an address"
            raise argparse.ArgumentTypeError(message) from None
    return text


def _trains(text: str) -> int:
    if not (text.isascii() and text.isdecimal()) or not 0 < int(text) <= ROSTER_MAX:
        raise argparse.ArgumentTypeError(f"{text} is not in 1..{ROSTER_MAX}")
    return int(text)


def _days(text: str) -> float:
    try:
        days = float(text)
    except ValueError:
        days = 0.0
    if not 0.0 < days <= 3650.0:
        raise argparse.ArgumentTypeError(f"{text} is not a number of days up to 3650")
    return days


def _complain(words: object, code: int) -> int:
    print(f"vobc: {words}", file=sys.stderr)
    return code
