"""What kernels are compiled with."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from stages.kernels.compiled import (
    as_input,
    compiled,
    compiled_contracted,
    prefetch,
    prefetch_to_write,
)


@compiled
def total_asking_ahead(values: np.ndarray, ahead: int) -> Any:
    total = 0.0
    for i in range(len(values)):
        prefetch(values, i + ahead)
        prefetch_to_write(values, np.uint64(i))
        total += values[i]
    return total


@pytest.mark.parametrize("ahead", [0, 7, -5, 2**40, -(2**40)])
def test_asking_for_memory_changes_nothing_wherever_it_is(ahead: int) -> None:
    values = np.arange(100.0)
    assert total_asking_ahead(values, ahead) == 4950.0
    assert values.tolist() == list(range(100))


@compiled_contracted
def multiply_add(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Any:
    return a * b + c


def test_a_contracted_kernel_is_right_to_one_rounding() -> None:
    a, b, c = np.random.default_rng(0).normal(size=(3, 1_000)).astype(np.float32)
    exact = a.astype(np.float64) * b + c
    magnitude = np.abs(a.astype(np.float64) * b) + np.abs(c)
    assert (np.abs(multiply_add(a, b, c) - exact) <= 2**-23 * magnitude).all()


def test_an_input_is_contiguous_and_read_only_and_its_origin_is_not_locked() -> None:
    origin = np.arange(12.0).reshape(3, 4)
    for array in (origin, origin.T, origin[:, ::2]):
        taken = as_input(array)
        assert taken.flags.c_contiguous
        assert not taken.flags.writeable
        np.testing.assert_array_equal(taken, array)
    assert origin.flags.writeable
