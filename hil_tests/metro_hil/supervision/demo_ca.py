"""`vobc demo-ca`: a certificate authority for demonstrations, with all files of a secured line."""

import argparse
import ipaddress
import re
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from firmware_py.clock.clock import WallClock
from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from firmware_py.trackdb.areas import load_areas
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_OK, EXIT_USAGE
from zenoh_config.secured import (
    SUPERVISION_NAME,
    WAYSIDE_NAME,
    client_settings,
    train_name,
    wayside_settings,
)
from zenoh_config.t2t import ROSTER_MAX

AUTHORITY: Final = "demonstration authority"
EARLIER_S: Final = 300
"""Certificates are valid from this long ago, because other machines' clocks may be slow."""
KEY_BYTES: Final = 32
DAY_S: Final = 86_400
PRIVATE_MODE: Final = 0o600
HOSTS: Final = ("localhost", "127.0.0.1")
LABEL: Final = r"[A-Za-z0-9](?:[A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
NAME: Final = re.compile(rf"{LABEL}(?:\.{LABEL})*")
NS_PER_S: Final = 1_000_000_000


def main(words: Sequence[str]) -> int:
    """Run the command; exit code 2 for invalid options, 3 for a folder that cannot be written."""
    options = parser().parse_args(words)
    try:
        make(
            options.folder,
            line=load_areas(options.line).name,
            trains=options.trains,
            days=options.days,
            hosts=(*HOSTS, *options.host),
            epoch_s=WallClock().epoch_ns() // NS_PER_S,
        )
    except SettingsError as error:
        return _complain(error, EXIT_USAGE)
    except OSError as error:
        return _complain(f"{options.folder}: {error.strerror}", EXIT_ENVIRONMENT)
    print(f"{options.folder}: for {WAYSIDE_NAME}, {SUPERVISION_NAME} and {options.trains} trains,")
    print(f"{options.days:g} days; for demonstrations only: the authority's key lies beside it")
    print(f"plant wayside --line {options.line} --secure {options.folder}")
    return EXIT_OK


def make(
    folder: Path, *, line: str, trains: int, days: float, hosts: Sequence[str], epoch_s: int
) -> None:
    """Write certificates, keys, session settings and the key of safety codes.

    Raises OSError, and SettingsError for a folder that is not empty.
    """
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.resolve()
    if (folder / "ca.pem").exists():
        raise SettingsError(f"{folder}/ca.pem: exists already; choose another folder or remove it")
    if any(folder.iterdir()):
        raise SettingsError(f"{folder}: not empty; choose a new folder for the keys")
    span_s = (epoch_s - EARLIER_S, epoch_s + round(days * DAY_S))
    authority_key = ec.generate_private_key(ec.SECP256R1())
    authority = _authority(authority_key, span_s)
    _write_key(folder / "ca.key", authority_key)
    for name in (WAYSIDE_NAME, SUPERVISION_NAME, *[train_name(n + 1) for n in range(trains)]):
        key = ec.generate_private_key(ec.SECP256R1())
        found = _issued(name, key, authority, authority_key, hosts, span_s)
        _write_key(folder / f"{name}.key", key)
        (folder / f"{name}.pem").write_bytes(found.public_bytes(serialization.Encoding.PEM))
        if name == WAYSIDE_NAME:
            settings = wayside_settings(str(folder), line, trains)
        else:
            settings = client_settings(str(folder), name)
        (folder / f"{name}.json5").write_text(settings, encoding="utf-8")
    _write_private(folder / "line.key", (secrets.token_hex(KEY_BYTES) + "\n").encode())
    (folder / "ca.pem").write_bytes(authority.public_bytes(serialization.Encoding.PEM))


def _authority(key: ec.EllipticCurvePrivateKey, span_s: tuple[int, int]) -> x509.Certificate:
    name = _name(AUTHORITY)
    builder = _builder(name, name, key, span_s)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    return builder.sign(key, hashes.SHA256())


def _issued(
    name: str,
    key: ec.EllipticCurvePrivateKey,
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    hosts: Sequence[str],
    span_s: tuple[int, int],
) -> x509.Certificate:
    builder = _builder(_name(name), authority.subject, key, span_s)
    usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
    builder = builder.add_extension(x509.ExtendedKeyUsage(usages), False)
    names = x509.SubjectAlternativeName([_host(each) for each in hosts])
    return builder.add_extension(names, False).sign(authority_key, hashes.SHA256())


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


def _write_key(path: Path, key: ec.EllipticCurvePrivateKey) -> None:
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
    top.add_argument("folder", type=Path, metavar="FOLDER", help="a new folder")
    top.add_argument("--line", default="loop", metavar="NAME|FILE", help="default: loop")
    top.add_argument("--trains", type=_trains, default=8, metavar="N", help="default: 8")
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
