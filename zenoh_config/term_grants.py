"""Signatures by which arbiters prove to every train which train they granted a term.

Theory
------
A train that believes the first sender of a new term would obey a hostile train. Each arbiter
therefore signs its grants with a key of its own (Ed25519), and a master shows the grants of a
majority in its heartbeats. A train has only the public keys: it can check a grant, and cannot make
one.

A grant names area, term, holder, arbiter and the end of the lease by the holder's clock. Arbiters
never grant a term to two trains, and majorities overlap, so one term has one proven holder.
Ed25519 uses no random numbers: equal grants have equal signatures.
"""

import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

from zenoh_config.soundness import MAX_STAMP_NS
from zenoh_config.t2t import SignedGrant

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

SIGNED: Final = struct.Struct(">18sBQHHQ")
"""Purpose, area, term, holder, arbiter, end of the lease."""
PURPOSE: Final = b"metro term grant 1"
"""Keeps a signature from being taken for one of another kind of statement."""
KEY_BYTES: Final = 32
CHECKED_MAX: Final = 1024
"""Number of checked grants that are remembered. All trains of one program check the same ones."""


class TermGrant(NamedTuple):
    """What an arbiter states about a term."""

    area: int
    term: int
    holder: int
    arbiter: int
    end_ns: int
    """End of the lease by the holder's clock."""

    def signed_bytes(self) -> bytes:
        """Bytes that the arbiter signs."""
        return SIGNED.pack(PURPOSE, *self)


class GrantSigner:
    """Signs the grants of one arbiter."""

    def __init__(self, key: "Ed25519PrivateKey") -> None:
        self._key = key

    def signed(
        self, *, area: int, term: int, holder: int, arbiter: int, end_ns: int
    ) -> SignedGrant:
        """The end is cut to the range of times: the sender of the request chose it."""
        end_ns = min(max(end_ns, 0), MAX_STAMP_NS)
        grant = TermGrant(area, term, holder, arbiter, end_ns)
        return SignedGrant(arbiter, end_ns, self._key.sign(grant.signed_bytes()))


class GrantCheck:
    """Checks the grants of all arbiters of a line."""

    def __init__(self, keys: Mapping[int, bytes]) -> None:
        """Take the public keys by the arbiter's address. Raises ValueError for an invalid key."""
        # Imported here because only lines with signed grants use it.
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        self._keys: dict[int, Ed25519PublicKey] = {
            arbiter: Ed25519PublicKey.from_public_bytes(key) for arbiter, key in keys.items()
        }
        self._invalid = InvalidSignature
        self._checked = lru_cache(maxsize=CHECKED_MAX)(self._check)

    def holds(self, grant: TermGrant, signature: bytes) -> bool:
        """Tell whether this arbiter signed this grant."""
        return self._checked(grant, signature)

    def _check(self, grant: TermGrant, signature: bytes) -> bool:
        key = self._keys.get(grant.arbiter)
        if key is None:
            return False
        try:
            key.verify(signature, grant.signed_bytes())
        except self._invalid:
            return False
        return True


def signer_from_seed(seed: bytes) -> tuple[GrantSigner, bytes]:
    """Return the signer with this private key of 32 bytes, and its public key."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.from_private_bytes(seed)
    return GrantSigner(key), key.public_key().public_bytes_raw()
