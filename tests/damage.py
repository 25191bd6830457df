"""Damage to the bytes of a file."""

from collections.abc import Sequence

BYTES = ("flip", "cut", "drop", "double", "zero", "insert")


def damaged(content: bytes, damage: Sequence[tuple[str, float, int]]) -> bytes:
    """Return bytes after damage of these kinds, each at a share of the length, of which bit or how much."""
    for kind, share, size in damage:
        at = min(int(share * len(content)), max(len(content) - 1, 0))
        if kind == "flip" and content:
            content = content[:at] + bytes([content[at] ^ (1 << (size % 8))]) + content[at + 1 :]
        elif kind == "cut":
            content = content[:at]
        elif kind == "drop":
            content = content[:at] + content[at + size :]
        elif kind == "double":
            content = content[: at + size] + content[at:]
        elif kind == "zero":
            content = content[:at] + bytes(min(size, len(content) - at)) + content[at + size :]
        elif kind == "insert":
            content = content[:at] + bytes([size]) * (size % 7) + content[at:]
    return content
