"""A digest tells payloads apart by their values alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from pipeline.recording.digest import OVERHEAD_BYTES, digest_of, size_of


@dataclass(frozen=True)
class Cloud:
    points: Any
    name: str
    inner: Any = None


DIFFERENT = [
    None,
    False,
    0,
    0.0,
    -0.0,
    "",
    b"x",
    (),
    (0,),
    ((0,), 1),
    (0, (1,)),
    {"a": 1},
    {"a": 2},
    np.zeros(3),
    np.zeros((3, 1)),
    np.zeros(3, np.float32),
    np.zeros(0),
    Cloud(np.arange(6.0), "a"),
    Cloud(np.arange(6.0), "b"),
    Cloud(np.arange(6.0), "a", Cloud(np.arange(2), "a")),
    Cloud(np.arange(6.0)[::-1], "a"),
]


def test_different_payloads_have_different_digests() -> None:
    digests = [digest_of(payload) for payload in DIFFERENT]
    assert None not in digests
    assert len(set(digests)) == len(DIFFERENT)


def test_a_strided_array_has_the_digest_of_its_copy() -> None:
    table = np.arange(24.0).reshape(4, 6)
    assert digest_of(table[:, ::2]) == digest_of(table[:, ::2].copy())
    assert digest_of(table.T) == digest_of(table.T.copy())


def test_a_digest_stays_what_it_is_in_every_process_and_version() -> None:
    assert digest_of(Cloud(np.arange(3, dtype=np.int32), "lidar")) == "76c645edb94941da"


@pytest.mark.parametrize("payload", [object(), np.array([object()]), {1: {2}}])
def test_what_cannot_be_walked_has_no_digest(payload: Any) -> None:
    assert digest_of(payload) is None


def test_a_size_counts_the_arrays_wherever_they_are() -> None:
    inner = Cloud(np.zeros(100), "")
    assert size_of(Cloud(np.zeros(1000, np.uint8), "ab", inner)) == 2 * OVERHEAD_BYTES + 1802
    assert size_of(np.zeros(10)) == OVERHEAD_BYTES + 80
    assert size_of(7) == OVERHEAD_BYTES
