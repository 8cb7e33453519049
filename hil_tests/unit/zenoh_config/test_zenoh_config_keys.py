"""The virtual radio matches keys exactly as zenoh does."""

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from zenoh_config import keys, t2t_keys

chunks = st.sampled_from(["a", "b", "ma", "7", "17"])
key_texts = st.lists(chunks, min_size=1, max_size=6).map("/".join)
expressions = (
    st.lists(chunks | st.just("*") | st.just("**"), min_size=1, max_size=6)
    .map("/".join)
    .map(lambda text: str(zenoh.KeyExpr.autocanonize(text)))
)


@given(expressions, key_texts)
def test_an_expression_matches_the_same_keys_as_in_zenoh(expression: str, key: str) -> None:
    assert keys.matches(expression, key) == zenoh.KeyExpr(expression).includes(key)


@pytest.mark.parametrize("expression", ["", "/a", "a/", "a//b", "a*", "a/$*", "a/#", "a?b/**"])
def test_an_invalid_expression_is_refused_by_name(expression: str) -> None:
    with pytest.raises(ValueError, match="not a key expression"):
        keys.matches(expression, "a/b")


@pytest.mark.parametrize("key", ["", "/a", "a//b", "a/*", "a/b$"])
def test_an_invalid_key_is_refused_by_name(key: str) -> None:
    with pytest.raises(ValueError, match="not a key"):
        keys.matches("**", key)


def test_a_wayside_receives_all_reports_of_its_area_and_nothing_else() -> None:
    wanted = keys.reports("florence")

    assert keys.matches(wanted, keys.report("florence", 7))
    assert keys.matches(wanted, keys.report("florence", 65535))
    assert not keys.matches(wanted, keys.report("florence", 7, area=2))
    assert not keys.matches(wanted, keys.report("tokyo", 7))
    assert not keys.matches(wanted, keys.authority("florence", 0, 7))


def test_a_train_receives_its_own_authorities_from_every_issuer_and_area() -> None:
    wanted = keys.authorities("florence", 7)

    assert keys.matches(wanted, keys.authority("florence", 0, 7))
    assert keys.matches(wanted, keys.authority("florence", 3, 7, area=2))
    assert not keys.matches(wanted, keys.authority("florence", 0, 17))
    assert not keys.matches(wanted, keys.report("florence", 7))


@given(st.text(max_size=30))
def test_every_line_name_gives_valid_zenoh_keys(name: str) -> None:
    zenoh.KeyExpr(keys.reports(name))
    zenoh.KeyExpr(keys.authorities(name, 1))

    assert keys.matches(keys.reports(name), keys.report(name, 1))


@pytest.mark.parametrize(
    ("name", "chunk"),
    [("florence", "florence"), ("Ligne 14", "ligne-14"), ("a/b*", "a-b"), ("線", "line")],
)
def test_a_line_name_becomes_one_chunk(name: str, chunk: str) -> None:
    assert keys.line_chunk(name) == chunk


@pytest.mark.parametrize(
    ("key", "sender"),
    [
        ("m/loop/w/3/hb/1/all", "train 3"),
        ("m/loop/w/65100/de/0/0", "supervision"),
        ("m/loop/w/0/tk/1/3", "the wayside"),
        ("m/loop/w/65001/gr/1/3", "address 65001"),
        ("m/loop/w/999999999999999/gr/1/3", "address 99999"),
        ("m/loop/w/T3/hb/1/all", "an unknown sender"),
        ("m/loop", "an unknown sender"),
        ("", "an unknown sender"),
    ],
)
def test_a_refused_message_is_named_by_the_writer_of_its_key(key: str, sender: str) -> None:
    assert t2t_keys.sender_text(t2t_keys.writer_of(key)) == sender
