"""Stamps of nodes as text: the comment `# stamp: TIME` at the end of a vertex's line.

g2o reads as many numbers of a line as a vertex has, and ignores what follows. Integers are
nanoseconds. Seconds have a decimal point or an exponent, so that both read back as they were.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masat.arrays import Floats, Ids, Stamps
from masat.errors import GraphError
from masat.formats.text import integer_of, is_integer, number_of

_NANOSECONDS = 10**9


def stamp_texts(stamps: Stamps) -> list[str]:
    """Return the texts of stamps, (n,), that `read_stamps` turns into the same stamps."""
    return [repr(stamp) for stamp in stamps.tolist()]


def seconds_texts(stamps: Stamps) -> list[str]:
    """Return the texts of stamps, (n,), in seconds; those of nanoseconds have nine decimals."""
    if stamps.dtype.kind == "f":
        return stamp_texts(stamps)
    out = []
    for stamp in stamps.tolist():
        whole, rest = divmod(abs(stamp), _NANOSECONDS)
        out.append(f"{'-' if stamp < 0 else ''}{whole}.{rest:09d}")
    return out


def read_stamps(texts: Sequence[bytes], ids: Ids) -> Stamps:
    """Return the stamps of texts, (n,): int64 if they are integers, otherwise float64.

    Raises
    ------
    GraphError
        If a text is empty or no time, or if integers and other numbers are mixed. Its `node` is
        the index of the first invalid text.
    """
    words = [text.decode("utf-8", "replace") for text in texts]
    integers = next((is_integer(word) for word in words if word), False)
    times = [integer_of(word) if is_integer(word) else number_of(word) for word in words]
    for k, word in enumerate(words):
        if word == "":
            raise GraphError(
                f"vertex {ids[k]} has no stamp, but another one has: give each vertex a comment "
                "such as '# stamp: 12.5', or none",
                node=k,
            )
        if times[k] is None:
            raise GraphError(
                f"the stamp {word!r:.40} of vertex {ids[k]} is no time: it must be seconds, such "
                "as 12.5, or an integer of at most 64 bits, in nanoseconds",
                node=k,
            )
        if is_integer(word) != integers:
            raise GraphError(
                f"the stamp {word!r:.40} of vertex {ids[k]} is in "
                f"{'seconds' if integers else 'nanoseconds (an integer)'}, but those before are in "
                f"{'nanoseconds (integers)' if integers else 'seconds'}",
                node=k,
            )
    return np.array(times, np.int64) if integers else np.array(times, np.float64)


def read_seconds(texts: Sequence[bytes]) -> Floats:
    """Return the stamps of texts in seconds, (n,), which must be numbers that occur once.

    Raises
    ------
    GraphError
        If two stamps are the same. Its `node` is the index of the second one.
    """
    stamps = np.array([float(text) for text in texts])
    order = np.argsort(stamps, kind="stable")
    again = order[1:][stamps[order[1:]] == stamps[order[:-1]]]
    if len(again):
        k = int(again.min())
        raise GraphError(
            f"the stamp {texts[k].decode()} occurs twice: a trajectory has one pose at a time",
            node=k,
        )
    return stamps
