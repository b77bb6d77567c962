"""A .ksplat of five splats, made byte by byte from its format."""

import struct

import numpy as np


def ksplat(level: int, degree: int) -> tuple[bytes, np.ndarray]:
    """Five splats in two full buckets of two and one of one; and where they are."""
    n_rest = (0, 3, 8)[degree]
    kind, sh_kind = (("<f4", "<f4"), ("<f2", "<f2"), ("<f2", "u1"))[level]
    position = "<f4" if level == 0 else "<u2"
    fields = [("c", position, 3), ("s", kind, 3), ("q", kind, 4), ("rgba", "u1", 4)]
    rows = np.zeros(5, [*fields, *([("sh", sh_kind, 3 * n_rest)] if n_rest else [])])
    centres = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]], "<f4")
    rows["c"] = 32767 + 100 * np.arange(15).reshape(5, 3) if level else np.eye(5, 3)
    where = np.eye(5, 3)
    if level:
        where = 100 * np.arange(15).reshape(5, 3) * (5.0 / 2 / 32767) + centres[[0, 0, 1, 1, 2]]
    rows["s"], rows["q"][:, 0], rows["rgba"] = 0.5, 1, (255, 128, 0, 128)
    if n_rest:
        values = np.arange(3 * n_rest) * 10
        rows["sh"] = values if level == 2 else values / 100
    head = bytearray(4096 + 1024)
    struct.pack_into("<BBxxIIIIHxx", head, 0, 0, 1, 1, 1, 5, 5, level)
    struct.pack_into("<ff", head, 36, -2.0, 2.0)
    struct.pack_into("<4IfHxx4IH", head, 4096, 5, 5, 2, 3, 5.0, 12, 32767, 0, 2, 1, degree)
    return bytes(head) + struct.pack("<I", 1) + centres.tobytes() + rows.tobytes(), where
