from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelerators.tensors import BoundFile, InputForm, OutputForm
from pipeline.errors import ModelError
from pipeline.model import ModelSpec, Native, Tensor, TensorSpec

HEIGHT, WIDTH = 2, 5


class Recorder:
    """A model that keeps what it was given and returns it."""

    def __init__(self, file: TensorSpec, out: TensorSpec | None = None) -> None:
        self.inputs: Mapping[str, TensorSpec] = {"in": file}
        self.outputs: Mapping[str, TensorSpec] = {"out": out or file}
        self.batches: list[int] = []

    def infer(self, inputs: Native) -> Native:
        self.batches.append(len(inputs["in"]))
        return {"out": inputs["in"].copy()}


def bound(file: TensorSpec, *, dtype: str = "uint8", form: InputForm | None = None) -> BoundFile:
    spec = ModelSpec("net", "image", (HEIGHT, WIDTH, 3), dtype, "rgb")
    form = form or InputForm()
    return BoundFile(spec, Recorder(file), form, {"y": OutputForm("out", nchw=form.nchw)})


def image(n: int = 1, seed: int = 0) -> Any:
    shape = (n, HEIGHT, WIDTH, 3)
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


@given(
    scale=st.floats(0.002, 0.1),
    zero_point=st.integers(-100, 200),
    mean=st.tuples(*[st.floats(0, 255)] * 3),
    std=st.tuples(*[st.floats(1, 255)] * 3),
    dtype=st.sampled_from(["uint8", "int8"]),
)
def test_8_bit_input_is_normalized_then_quantized(
    scale: float,
    zero_point: int,
    mean: tuple[float, float, float],
    std: tuple[float, float, float],
    dtype: str,
) -> None:
    file = TensorSpec((1, HEIGHT, WIDTH, 3), dtype, scale, zero_point)
    x = image()
    found = bound(file, form=InputForm(mean, std)).encode({"image": Tensor(x)})["in"]
    real = (x.astype(np.float64) - mean) / std
    limits = np.iinfo(dtype)
    expected = np.clip(real / scale + zero_point, limits.min, limits.max)
    assert found.dtype == dtype
    assert np.abs(found - expected).max() <= 0.51  # rounding, and float32 at half a count


def test_float_input_is_normalized() -> None:
    file = TensorSpec((1, 3, HEIGHT, WIDTH), "float32")
    form = InputForm((10.0, 20.0, 30.0), (2.0, 4.0, 8.0), nchw=True)
    x = image()
    found = bound(file, form=form).encode({"image": Tensor(x)})["in"]
    expected = ((x - np.array([10, 20, 30])) / np.array([2, 4, 8])).transpose(0, 3, 1, 2)
    assert found.flags.c_contiguous
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


def test_an_image_that_is_already_quantized_is_not_copied() -> None:
    """The public DeepLab: (x - 128) / 128 with scale 1/128 and zero point 128 is x itself."""
    file = TensorSpec((1, HEIGHT, WIDTH, 3), "uint8", 1 / 128, 128)
    x = image()
    found = bound(file, form=InputForm((128.0,), (128.0,))).encode({"image": Tensor(x)})["in"]
    assert np.shares_memory(found, x)


def test_channels_are_reversed_for_a_file_of_the_other_order() -> None:
    file = TensorSpec((1, HEIGHT, WIDTH, 3), "uint8")
    x = image()
    found = bound(file, form=InputForm(reverse_channels=True)).encode({"image": Tensor(x)})["in"]
    np.testing.assert_array_equal(found, x[..., ::-1])


@pytest.mark.parametrize(("batch", "calls"), [(1, [1, 1, 1]), (-1, [3]), (3, [3])])
def test_a_file_of_batch_one_takes_the_images_one_after_another(
    batch: int, calls: list[int]
) -> None:
    net = bound(TensorSpec((batch, HEIGHT, WIDTH, 3), "uint8"))
    x = image(3)
    tensors = net.decode(net.infer(net.encode({"image": Tensor(x)})))
    np.testing.assert_array_equal(tensors["y"].array, x)
    assert isinstance(net._model, Recorder)
    assert net._model.batches == calls


def test_outputs_are_canonical_views_with_their_quantization() -> None:
    file = TensorSpec((1, 3, HEIGHT, WIDTH), "uint8", 0.5, 7)
    net = bound(file, form=InputForm(nchw=True))
    native = {"out": np.arange(30, dtype=np.uint8).reshape(1, 3, HEIGHT, WIDTH)}
    out = net.decode(native)["y"]
    assert out.array.shape == (1, HEIGHT, WIDTH, 3)
    assert np.shares_memory(out.array, native["out"])
    assert (out.scale, out.zero_point) == (0.5, 7)
    assert out.values()[0, 0, 1, 0] == (1 - 7) * 0.5


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros((1, 4, 4, 3), np.uint8), r"takes \(n, 2, 5, 3\)"),
        (np.zeros((HEIGHT, WIDTH, 3), np.uint8), r"takes \(n, 2, 5, 3\)"),
        (np.zeros((1, HEIGHT, WIDTH, 3), np.float32), "takes uint8, not float32"),
    ],
)
def test_a_stage_that_prepares_something_else_is_told(array: Any, said: str) -> None:
    net = bound(TensorSpec((1, HEIGHT, WIDTH, 3), "uint8"))
    with pytest.raises(ModelError, match=said):
        net.encode({"image": Tensor(array)})


def test_a_file_of_another_size_than_the_registry_says_is_refused() -> None:
    with pytest.raises(ModelError, match="the registry says"):
        bound(TensorSpec((1, 9, 9, 3), "uint8"))
