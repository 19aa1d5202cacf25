"""Damage to bytes, the same for the same seed."""

import random
from collections.abc import Callable

#: Numbers that formats keep in 1, 2, 4 or 8 bytes, at the edges of what they can be.
_EDGES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
_WORDS = (
    b"-1", b"0", b"1e999", b"nan", b"inf", b"null", b"[]", b"{}", b"''", b"&a [*a]", b"*a", b"!!python/name:os.system",
    b"../../../etc/passwd", b"<!DOCTYPE r [<!ENTITY x SYSTEM 'file:///etc/passwd'>]>", b"&x;", b"\x00", b"\x1b[2J",
    b"</script><script>", b"9" * 400, b"zstd", b"lz4", b"ros1msg", b"<link name='base_link'/>",
)  # fmt: skip


def _place(data: bytearray, dice: random.Random) -> int:
    return dice.randrange(len(data)) if data else 0


def _flip(data: bytearray, dice: random.Random) -> None:
    for _ in range(dice.choice((1, 1, 2, 8))):
        if data:
            data[_place(data, dice)] ^= 1 << dice.randrange(8)


def _edge(data: bytearray, dice: random.Random) -> None:
    size, at = dice.choice((1, 2, 4, 8)), _place(data, dice)
    value = (dice.choice(_EDGES) % 2 ** (8 * size)).to_bytes(size, dice.choice(("little", "big")))
    data[at : at + size] = value


def _cut(data: bytearray, dice: random.Random) -> None:
    del data[_place(data, dice) :]


def _remove(data: bytearray, dice: random.Random) -> None:
    at = _place(data, dice)
    del data[at : at + dice.choice((1, 4, 16, 256, 4096))]


def _repeat(data: bytearray, dice: random.Random) -> None:
    at = _place(data, dice)
    piece = bytes(data[at : at + dice.choice((1, 8, 64, 1024))])
    data[at:at] = piece * dice.choice((1, 2, 50))


def _zero(data: bytearray, dice: random.Random) -> None:
    at = _place(data, dice)
    end = min(len(data), at + dice.choice((4, 64, 512, 4096)))
    data[at:end] = bytes(end - at)


def _garbage(data: bytearray, dice: random.Random) -> None:
    at = _place(data, dice)
    data[at:at] = dice.randbytes(dice.choice((1, 16, 300)))


def _word(data: bytearray, dice: random.Random) -> None:
    at = _place(data, dice)
    data[at : at + dice.choice((0, 0, 1, 5))] = dice.choice(_WORDS)


def _move(data: bytearray, dice: random.Random) -> None:
    start, size = _place(data, dice), dice.choice((8, 100, 2000))
    piece = data[start : start + size]
    del data[start : start + size]
    at = _place(data, dice)
    data[at:at] = piece


MUTATIONS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    _flip, _flip, _edge, _edge, _cut, _remove, _repeat, _zero, _garbage, _word, _word, _move,
)  # fmt: skip


def mutated(data: bytes, dice: random.Random) -> bytes:
    """The data with one to a few kinds of damage."""
    result = bytearray(data)
    for _ in range(dice.choice((1, 1, 1, 2, 3, 6))):
        dice.choice(MUTATIONS)(result, dice)
    return bytes(result)
