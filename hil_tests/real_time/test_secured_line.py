"""A client without a certificate, or with a name other than its own, sends and receives nothing."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from firmware_py.clock.clock import WallClock
from firmware_py.radio.credentials import (
    Credentials,
    load_arbiter_keys,
    load_arbiter_signing_keys,
    load_credentials,
)
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import SessionRole, ZenohRadio, open_radio, pick_endpoint
from firmware_py.settings import SettingsError
from metro_hil.cli.vobc import main as vobc
from metro_hil.supervision.demo_ca import make
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, LineKeys, pack, unpack
from zenoh_config.messages import Refused, RefusedReason
from zenoh_config.secured import wayside_settings
from zenoh_config.t2t import AreaAuthority, LeaseKind, LeaseRequest, RosterAck, T2tMessage
from zenoh_config.term_grants import GrantCheck, GrantSigner, TermGrant

NS_PER_S = 1_000_000_000
PATIENCE_S = 8.0
CLOCK = WallClock()
NOW_S = CLOCK.epoch_ns() // NS_PER_S
TO_1 = AreaAuthority(2, 1, 1, 7, 1, 1, 0, 1, 0, 900.0, 80.0, 0, 1, ())
ACK_TO_1 = RosterAck(65_001, 1, 1, 7, 1, 1, 0, 3)
REQUEST = LeaseRequest(1, 65_001, 1, 7, 1, 1, 0, LeaseKind.ACQUIRE, 5, 0)
TO_2 = RosterAck(65_001, 2, 1, 7, 1, 1, 0, 3)


class Line:
    """A wayside and its clients."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        make(folder, line="loop", trains=2, days=1.0, hosts=["127.0.0.1"], epoch_s=NOW_S)
        self.endpoint = pick_endpoint()
        self.open: list[ZenohRadio] = []
        self.wayside = self.radio(
            SessionRole.WAYSIDE, ("m/loop/w/**",), self.credentials("wayside")
        )

    def credentials(self, name: str) -> Credentials:
        listens = name == "wayside"
        return load_credentials(self.folder, name, CLOCK.epoch_ns(), listens=listens)

    def radio(
        self, role: SessionRole, topics: tuple[str, ...], secure: Credentials | None
    ) -> ZenohRadio:
        radio = open_radio(role, self.endpoint, topics, CLOCK, secure=secure)
        self.open.append(radio)
        return radio

    def train(self, number: int, secure: Credentials | None = None) -> ZenohRadio:
        """A connected train that subscribes to everything, permitted or not."""
        radio = self.radio(
            SessionRole.TRAIN,
            (*t2t_keys.of_train("loop", number), "m/loop/w/**"),
            secure or self.credentials(f"T{number}"),
        )
        assert until(lambda: radio.connected)
        return radio

    def close(self) -> None:
        for radio in reversed(self.open):
            radio.close()


def impatient(credentials: Credentials) -> Credentials:
    """Settings with which a refused attempt to connect ends after half a second."""
    assert "timeout_ms: 4000" in credentials.settings
    short = credentials.settings.replace("timeout_ms: 4000", "timeout_ms: 500")
    return Credentials(short, credentials.line_keys)


def errors_of(radio: ZenohRadio) -> Callable[[], bool]:
    """A condition that holds once the radio has an error."""
    return lambda: radio.counters.errors > 0


def until(done: Callable[[], bool]) -> bool:
    end_ns = CLOCK.now_ns() + round(PATIENCE_S * NS_PER_S)
    while CLOCK.now_ns() < end_ns:
        if done():
            return True
        CLOCK.wait_until(CLOCK.now_ns() + 20_000_000)
    return False


def heard(
    sender: ZenohRadio, receiver: ZenohRadio, wanted: T2tMessage, *others: T2tMessage
) -> set[str]:
    """The keys received until the wanted message arrives; the other messages are sent before it
    each time."""
    keys: set[str] = set()

    def came() -> bool:
        now_ns = CLOCK.now_ns()
        for each in (*others, wanted):
            sender.send(now_ns, t2t_keys.key_of("loop", each), pack(each))
        keys.update(each.key for each in receiver.receive(now_ns))
        return t2t_keys.key_of("loop", wanted) in keys

    assert until(came)
    return keys


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    made = Line(tmp_path / "secure")
    yield made
    made.close()


def test_a_train_receives_its_own_messages_and_none_for_another(line: Line) -> None:
    second = line.train(2)

    keys = heard(line.wayside, second, TO_2, ACK_TO_1)

    assert keys == {t2t_keys.key_of("loop", TO_2)}


def test_messages_of_a_train_under_another_name_are_dropped(line: Line) -> None:
    second = line.train(2)
    as_one = RosterAck(1, 65_001, 1, 7, 1, 1, 0, 3)

    keys = heard(second, line.wayside, TO_1, as_one)

    assert keys == {t2t_keys.key_of("loop", TO_1)}


@pytest.mark.parametrize(
    ("name", "address", "other"),
    [("arbiter1", 65_001, 0), ("arbiter2", 65_002, 1), ("track", 0, 65_001)],
)
def test_each_program_of_the_wayside_sends_under_its_own_address_only(
    line: Line, name: str, address: int, other: int
) -> None:
    sender = line.radio(SessionRole.TRAIN, (), line.credentials(name))
    first, own = line.train(1), replace(ACK_TO_1, source=address)

    keys = heard(sender, first, own, replace(ACK_TO_1, source=other))

    assert keys == {t2t_keys.key_of("loop", own)}


def test_an_arbiter_receives_no_request_to_another_one(line: Line) -> None:
    topics = (*t2t_keys.of_arbiter("loop", 65_001), *t2t_keys.of_arbiter("loop", 65_002))
    arbiter = line.radio(SessionRole.TRAIN, topics, line.credentials("arbiter1"))
    first = line.train(1)

    keys = heard(first, arbiter, REQUEST, replace(REQUEST, destination=65_002))

    assert keys == {t2t_keys.key_of("loop", REQUEST)}


def test_only_supervision_sees_sessions_and_only_under_their_true_names(
    line: Line,
) -> None:
    """Train 2 declares the token of train 1, too, and asks who is there."""
    watched = t2t_keys.tokens("loop")

    def opened(name: str, token: str | None) -> ZenohRadio:
        radio = open_radio(
            *(SessionRole.TRAIN, line.endpoint, (), CLOCK),
            secure=line.credentials(name),
            token=token,
            watched_tokens=watched,
        )
        line.open.append(radio)
        assert until(lambda: radio.connected)
        return radio

    supervision = opened("supervision", None)
    own = t2t_keys.token_of("loop", 2)
    of_one = t2t_keys.token_of("loop", 1)
    second, as_one = opened("T2", own), opened("T2", of_one)

    assert until(lambda: supervision.present == {own})
    CLOCK.wait_until(CLOCK.now_ns() + NS_PER_S)
    assert supervision.present == {own}
    # A session does not receive its own declaration.
    assert second.present <= {own}
    assert as_one.present <= {of_one}


def test_a_client_without_a_certificate_of_the_line_gets_no_session(
    line: Line, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    make(other, line="loop", trains=1, days=1.0, hosts=["127.0.0.1"], epoch_s=NOW_S)
    stranger = load_credentials(other, "T1", CLOCK.epoch_ns())
    authority = (line.folder / "ca.pem").as_posix()
    # The client even has the line's authority certificate, so it is the wayside that refuses it.
    forged = impatient(
        Credentials(
            stranger.settings.replace((other / "ca.pem").as_posix(), authority), stranger.line_keys
        )
    )
    plain = line.radio(SessionRole.TRAIN, ("m/**",), None)
    masked = line.radio(SessionRole.TRAIN, ("m/**",), forged)
    first = line.train(1)

    heard(line.wayside, first, ACK_TO_1)

    for intruder in (plain, masked):
        assert until(errors_of(intruder))
        intruder.send(0, t2t_keys.key_of("loop", TO_1), pack(TO_1))
        assert not intruder.connected
        assert intruder.receive(CLOCK.now_ns()) == ()
    assert [each.key for each in line.wayside.receive(CLOCK.now_ns())] == []


def test_a_train_does_not_connect_to_a_router_with_the_certificate_of_another_train(
    tmp_path: Path,
) -> None:
    folder, endpoint = tmp_path / "secure", pick_endpoint()
    make(folder, line="loop", trains=2, days=1.0, hosts=["127.0.0.1"], epoch_s=NOW_S)
    wayside = load_credentials(folder, "wayside", CLOCK.epoch_ns(), listens=True)
    posed = Credentials(
        wayside.settings.replace("/wayside.pem", "/T2.pem").replace("/wayside.key", "/T2.key"),
        wayside.line_keys,
    )
    own = impatient(load_credentials(folder, "T1", CLOCK.epoch_ns()))

    with (
        open_radio(SessionRole.WAYSIDE, endpoint, (), CLOCK, secure=posed),
        open_radio(SessionRole.TRAIN, endpoint, (), CLOCK, secure=own) as train,
    ):
        assert until(errors_of(train))
        assert not train.connected


def test_a_train_goes_on_with_renewed_keys_without_a_gap(line: Line) -> None:
    first = line.train(1)
    of_one = RosterAck(1, 65_001, 1, 7, 1, 1, 0, 3)
    heard(first, line.wayside, of_one)

    assert vobc(["demo-ca", str(line.folder), "--renew", "T1", "--days", "2"]) == 0
    numbers: list[int] = []
    sent = 0

    def renewed() -> bool:
        nonlocal sent
        sent += 1
        first.send(CLOCK.now_ns(), t2t_keys.key_of("loop", of_one), sent.to_bytes(4, "big"))
        received = line.wayside.receive(CLOCK.now_ns())
        numbers.extend(int.from_bytes(each.payload, "big") for each in received)
        return first.renewals == 1 and sent in numbers

    assert until(renewed)
    assert set(numbers) >= set(range(numbers[0], sent))
    assert first.counters.dropped_out == 0
    heard(line.wayside, first, ACK_TO_1)


def test_each_line_has_its_own_safety_code_key(line: Line) -> None:
    key = LineKeys(line.credentials("T1").line_keys)
    refused = unpack(pack(TO_1, BENCH_KEY), key)

    assert isinstance(refused, Refused)
    assert refused.reason is RefusedReason.WRONG_CODE
    assert unpack(pack(TO_1, key), key) == TO_1


def test_zenoh_accepts_the_shipped_settings_and_those_for_many_trains() -> None:
    for trains in (1, 128):
        text = wayside_settings("secure", "loop", range(1, trains + 1))
        rules = zenoh.Config.from_json5(text).get_json("access_control/rules")

        assert len(re.findall('"T[0-9]+ sends"', rules)) == trains
        assert f'"m/loop/x/{trains}"' in rules


def test_the_settings_of_a_network_allow_each_of_its_paths_and_those_of_a_line_no_places() -> None:
    text = wayside_settings("secure", "hop", [1, 2], paths=["hop-out", "hop-back"])
    rules = zenoh.Config.from_json5(text).get_json("access_control/rules")

    for name in ("hop", "hop-out", "hop-back"):
        assert f'"m/{name}/w/2/**"' in rules
    for key in ("p/2", "e/2", "p/*", "e/*", "w/65100/rm/*/*", "w/*/rn/*/65100"):
        assert f'"m/hop/{key}"' in rules
    of_line = zenoh.Config.from_json5(wayside_settings("secure", "hop", [1, 2]))
    rules = of_line.get_json("access_control/rules")
    assert not [part for part in ("/p/", "/e/", "/rm/", "/rn/") if part in rules]


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda f: (f / "T1.pem").unlink(), "T1.pem: cannot be read: No such file"),
        (lambda f: (f / "T1.pem").write_text("x"), "T1.pem: no certificate"),
        (lambda f: (f / "T2.pem").rename(f / "T1.pem"), "T1.pem: it is of CN=T2, not of T1"),
        (lambda f: (f / "line.key").unlink(), "line.key: cannot be read"),
    ],
)
def test_invalid_credentials_are_reported_by_file(
    spoil: Callable[[Path], object], complaint: str, tmp_path: Path
) -> None:
    make(tmp_path, line="loop", trains=2, days=1.0, hosts=["localhost"], epoch_s=NOW_S)
    spoil(tmp_path)

    with pytest.raises(SettingsError, match=re.escape(complaint)):
        load_credentials(tmp_path, "T1", CLOCK.epoch_ns())


def test_the_keys_of_arbiters_belong_to_each_other_and_invalid_ones_are_reported(
    tmp_path: Path,
) -> None:
    make(tmp_path, line="loop", trains=1, days=1.0, hosts=["localhost"], epoch_s=NOW_S)
    check = GrantCheck(load_arbiter_keys(tmp_path, 5))

    for number, key in load_arbiter_signing_keys(tmp_path, range(1, 6)).items():
        signed = GrantSigner(key).signed(area=1, term=2, holder=3, arbiter=number, end_ns=4)
        assert check.holds(TermGrant(1, 2, 3, number, 4), signed.signature)

    (tmp_path / "grants1.pub").write_text("x")
    (tmp_path / "grants2.key").unlink()
    with pytest.raises(SettingsError, match=r"grants1.pub: no public Ed25519 key; make new"):
        load_arbiter_keys(tmp_path, 3)
    with pytest.raises(SettingsError, match=r"grants2.key: cannot be read: No such file"):
        load_arbiter_signing_keys(tmp_path, [1, 2])


def test_a_certificate_of_another_role_is_refused(tmp_path: Path) -> None:
    make(tmp_path, line="loop", trains=1, days=1.0, hosts=["localhost"], epoch_s=NOW_S)

    with pytest.raises(SettingsError, match=r"T1.pem: it is not for the role of the wayside alone"):
        load_credentials(tmp_path, "T1", CLOCK.epoch_ns(), listens=True)
    with pytest.raises(SettingsError, match=r"wayside.pem: it is not for the role of programs"):
        load_credentials(tmp_path, "wayside", CLOCK.epoch_ns())


def test_a_train_is_added_and_certificates_are_renewed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "ca"
    host = ["--host", "wayside.example"]
    assert vobc(["demo-ca", str(folder), "--trains", "2", "--days", "1", *host]) == 0
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    capsys.readouterr()

    words = ["--add", "T9", "--renew", "T2", "--renew", "wayside", "--days", "40"]
    assert vobc(["demo-ca", str(folder), *words]) == 0

    said = capsys.readouterr().out
    assert "T9: added; the wayside admits it from its next start on" in said
    assert "T2: renewed for 40 days" in said
    later_ns = CLOCK.epoch_ns() + 39 * 86_400 * NS_PER_S
    load_credentials(folder, "T9", later_ns)
    load_credentials(folder, "T2", later_ns)
    settings = load_credentials(folder, "wayside", later_ns, listens=True).settings
    known = [f"T{n}" for n in range(1, 10) if f'"T{n}"' in settings]
    assert known == ["T1", "T2", "T9"]
    changed = {n for n, content in before.items() if (folder / n).read_bytes() != content}
    assert changed == {"T2.key", "T2.pem", "wayside.key", "wayside.pem", "wayside.json5"}
    assert b"wayside.example" in x509.load_pem_x509_certificate(
        (folder / "wayside.pem").read_bytes()
    ).public_bytes(Encoding.DER)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--add", "T1"], "--add T1: it exists already; --renew makes a new one"),
        (["--add", "9"], "--add 9: not a train"),
        (["--add", "T0"], "--add T0: not a train"),
        (["--add", "ca"], "--add ca: not a train"),
        (["--renew", "T3"], "--renew T3: there is no "),
        (["--renew", "T1", "--line", "florence"], "--line florence: "),
        (["--renew", "T1", "--days", "3650"], "--days 3650: longer than "),
        (["--renew", "T1", "--trains", "4"], "--trains: not with --add or --renew"),
    ],
)
def test_a_change_of_certificates_that_cannot_be_made_changes_nothing(
    words: list[str],
    complaint: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "ca"
    make(folder, line="loop", trains=1, days=1.0, hosts=["localhost"], epoch_s=NOW_S - 999_999)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    assert vobc(["demo-ca", str(folder), *words]) == 2

    assert capsys.readouterr().err.startswith(f"vobc: {complaint}")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_the_key_of_safety_codes_changes_in_three_steps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "ca"
    make(folder, line="loop", trains=1, days=1.0, hosts=["localhost"], epoch_s=NOW_S)
    keys = LineKeys(load_credentials(folder, "T1", CLOCK.epoch_ns()).line_keys)
    before = keys.sending
    seen = []

    for step in ("add", "use", "drop"):
        assert vobc(["demo-ca", str(folder), "--line-key", step]) == 0
        keys.take((folder / "line.key").read_text())
        seen.append((keys.sending[0], sorted(keys.accepted)))

    assert seen == [(0, [0, 1]), (1, [0, 1]), (1, [1])]
    assert keys.sending[1] != before[1]
    assert ((folder / "line.key").stat().st_mode & 0o777) == 0o600
    assert "line.key: key 1 is sent with, key 0 is refused" in capsys.readouterr().out
    for step, words in (("use", "there is only one key"), ("add --add T9", "not with --add")):
        assert vobc(["demo-ca", str(folder), "--line-key", *step.split()]) == 2
        assert words in capsys.readouterr().err


def test_a_running_program_follows_the_key_file(tmp_path: Path) -> None:
    path = tmp_path / "line.key"
    path.write_text("00" * 16)
    keys = line_keys(Credentials("", path.read_text(), (), path), look_s=0.02)
    assert isinstance(keys, LineKeys)

    for text in ("1 xy", "1 " + "11" * 16):
        path.write_text(text)

    assert until(lambda: keys.sending == (1, b"\x11" * 16))


def test_a_folder_without_an_authority_cannot_renew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert vobc(["demo-ca", str(tmp_path), "--renew", "T1"]) == 2

    assert "ca.key: No such file or directory; was it made by" in capsys.readouterr().err


def test_expired_and_future_certificates_are_reported_with_their_dates(tmp_path: Path) -> None:
    make(tmp_path, line="loop", trains=1, days=1.0, hosts=["localhost"], epoch_s=1_000_000_000)

    with pytest.raises(SettingsError, match=r"T1.pem: expired on 2001-09-10 01:46 UTC; make new"):
        load_credentials(tmp_path, "T1", 1_000_090_000 * NS_PER_S)
    with pytest.raises(SettingsError, match=r"ca.pem: not valid before 2001-09-09 01:41 UTC"):
        load_credentials(tmp_path, "T1", 999_000_000 * NS_PER_S)


@pytest.mark.parametrize(
    "host", ["bad host!", "", "-a", "a..b", "a_b", "x" * 64, "::g", "é.example"]
)
def test_an_invalid_host_gets_no_certificate(
    host: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        vobc(["demo-ca", str(tmp_path / "ca"), f"--host={host}"])

    assert f"{host!r} is neither the name of a host nor an address" in capsys.readouterr().err
    assert not (tmp_path / "ca").exists()


def test_the_command_creates_credentials_once_and_names_the_next_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(tmp_path / "ca")

    assert vobc(["demo-ca", folder, "--trains", "1", "--host", "metro-1.example"]) == 0
    assert f"plant wayside --line loop --secure {folder}" in capsys.readouterr().out
    assert ((tmp_path / "ca" / "T1.key").stat().st_mode & 0o777) == 0o600

    assert vobc(["demo-ca", folder]) == 2
    assert "ca.pem: exists already" in capsys.readouterr().err
    assert vobc(["demo-ca", str(tmp_path)]) == 2
    assert f"{tmp_path}: not empty" in capsys.readouterr().err
    assert vobc(["line", "--secure", str(tmp_path)]) == 2
    assert "ca.pem: cannot be read" in capsys.readouterr().err
