"""Labels of edges as text: the comment `# label: NAME` at the end of an edge's line.

g2o reads as many numbers of a line as an edge has, and ignores what follows. A label that consists
of printable characters is written as it is. A string that would not read back as the same string
(it looks like an integer, or holds quotes, line ends or outer blanks) is written as in JSON.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from masat.arrays import Ids

_INTEGER = re.compile(r"0|-?[1-9][0-9]{0,18}")


def label_texts(labels: Ids | NDArray[np.str_]) -> list[str]:
    """Return the texts of labels, (m,), that `read_labels` turns into the same labels."""
    if labels.dtype.kind in "iu":
        return [str(label) for label in labels.tolist()]
    return [label if _is_plain(label) else json.dumps(label) for label in labels.tolist()]


def read_labels(texts: Sequence[bytes]) -> Ids | NDArray[np.str_]:
    """Return the labels of texts, (m,): int64 if all are integers, otherwise strings.

    An edge without a label, whose text is empty, gets -1 among integers and "" among strings.
    """
    words = [text.decode("utf-8", "replace") for text in texts]
    if all(word == "" or _is_integer(word) for word in words):
        return np.array([int(word or -1) for word in words], np.int64)
    return np.array([_unquoted(word) for word in words], np.str_)


def _is_plain(label: str) -> bool:
    return (
        label != ""
        and label.isprintable()
        and label == label.strip()
        and not label.startswith('"')
        and not _is_integer(label)
    )


def _is_integer(word: str) -> bool:
    return _INTEGER.fullmatch(word) is not None and -(2**63) <= int(word) < 2**63


def _unquoted(word: str) -> str:
    if not word.startswith('"'):
        return word
    try:
        label = json.loads(word)
    except ValueError:
        return word
    return label if isinstance(label, str) else word
