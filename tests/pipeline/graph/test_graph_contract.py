from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

import graph_stages
import pytest
from graph_stages import Boxes, GrayImage, Image, Pose, Scan

from pipeline.graph.contract import (
    ContractError,
    InputPort,
    OutputPort,
    contract_of,
    fits,
    options_of,
    type_name,
)
from pipeline.message import Message
from pipeline.model import Tensors
from pipeline.stage import ModelStage, Source, Stage

if TYPE_CHECKING:
    from decimal import Decimal


def test_a_source_says_its_payload_in_the_annotation_of_messages() -> None:
    contract = contract_of(graph_stages.Camera)
    assert contract.is_source
    assert contract.inputs == ()
    assert contract.outputs == (OutputPort("out", (GrayImage,)),)


def test_options_are_the_parameters_of_init_with_the_sentence_that_names_them() -> None:
    rate, delay, _ = contract_of(graph_stages.Camera).options
    assert (rate.name, rate.type_name, rate.default, rate.required) == (
        "rate_hz",
        "float",
        30.0,
        False,
    )
    assert rate.doc == "`rate_hz` is the rate of its frames."
    assert delay.doc == ""
    (path, *_) = contract_of(graph_stages.Lidar).options
    assert path.required
    assert path.annotation is Path


def test_the_messages_of_process_are_the_input_ports() -> None:
    assert contract_of(graph_stages.Fuse).inputs == (
        InputPort("scan", (Scan,)),
        InputPort("poses", (Pose,), span=True),
        InputPort("boxes", (Boxes,), optional=True, many=True, has_default=True),
        InputPort("image", (Image,), optional=True, has_default=True),
    )


def test_a_model_stage_takes_the_inputs_of_prepare_and_gives_what_finish_returns() -> None:
    contract = contract_of(graph_stages.Detect)
    assert contract.is_model
    assert contract.inputs == (InputPort("image", (Image,)),)
    assert contract.outputs == (OutputPort("out", (Boxes,)),)


def test_a_dataclass_marked_ports_is_one_port_per_field() -> None:
    assert contract_of(graph_stages.Split).outputs == (
        OutputPort("left", (GrayImage,)),
        OutputPort("right", (Image,)),
    )


def test_a_stage_that_returns_none_is_a_sink() -> None:
    assert contract_of(graph_stages.Save).outputs == ()


def test_the_calibration_is_no_option() -> None:
    contract = contract_of(graph_stages.Mount)
    assert [option.name for option in contract.options] == ["sensor"]
    assert contract.calibration is not None
    assert contract.calibration.kind is graph_stages.Rig


def test_a_union_of_payloads_takes_each_member() -> None:
    class Both(Stage):
        def process(self, thing: Message[Scan | Image]) -> Message[Scan] | Boxes | None: ...

    contract = contract_of(Both)
    assert contract.inputs == (InputPort("thing", (Scan, Image)),)
    assert contract.outputs == (OutputPort("out", (Scan, Boxes)),)


@dataclass
class Broken:
    """Classes that break the rules, each in one way."""

    class NoProcess(Stage):
        pass

    class Async(Stage):
        async def process(self, image: Message[Image]) -> Image: ...

    class Hidden(Stage):
        def process(self, image: Message[Decimal]) -> Image: ...

    class Bare(Stage):
        def process(self, image: Image) -> Image: ...

    class Pair(Stage):
        def process(self, images: tuple[Message[Image], Message[Image]]) -> Image: ...

    class Star(Stage):
        def process(self, *images: Message[Image]) -> Image: ...

    class Nothing(Stage):
        def process(self) -> Image: ...

    class Silent(Stage):
        def process(self, image: Message[Image]): ...  # type: ignore[no-untyped-def]

    class Swapped(ModelStage):
        def prepare(self, image: Message[Image]) -> Tensors: ...
        def finish(self, image: Message[Image], outputs: Tensors) -> Boxes: ...

    class Vague(Source):
        def messages(self):  # type: ignore[no-untyped-def]
            yield

    class Single(Source):
        def messages(self) -> Message[Image]: ...  # type: ignore[override]

    class Payload(Source):
        def messages(self) -> Iterator[Image]: ...  # type: ignore[override]

    class Loose(Stage):
        def __init__(self, **options: float) -> None: ...
        def process(self, image: Message[Image]) -> Image: ...


@pytest.mark.parametrize(
    ("cls", "sentence"),
    [
        (
            Broken.NoProcess,
            "NoProcess has no method 'process'; a Stage defines process, a ModelStage prepare and "
            "finish, a Source messages",
        ),
        (Broken.Async, "Async.process is async; a step is a plain method"),
        (
            Broken.Hidden,
            "an annotation of Hidden.process cannot be read: name 'Decimal' is not defined; import "
            "what it names at run time, not under TYPE_CHECKING",
        ),
        (
            Broken.Bare,
            "Bare.process: 'image' is Image; an input is Message[T], Message[T] | None, "
            "tuple[Message[T] | None, ...] or Span[T]",
        ),
        (
            Broken.Pair,
            "Pair.process: 'images' is tuple[Message[Image], Message[Image]]; an input is "
            "Message[T], Message[T] | None, tuple[Message[T] | None, ...] or Span[T]",
        ),
        (
            Broken.Star,
            "Star.process takes *images; name each input, without * or **",
        ),
        (Broken.Nothing, "Nothing.process takes no message; a stage without inputs is a Source"),
        (Broken.Silent, "Silent.process: annotate what it returns (None for a sink)"),
        (
            Broken.Swapped,
            "Swapped.finish must take the model's outputs and then the inputs of prepare (image); "
            "it takes (image, outputs)",
        ),
        (Broken.Vague, "Vague.messages: annotate what it returns as Iterator[Message[...]]"),
        (Broken.Single, "Single.messages: annotate what it returns as Iterator[Message[...]]"),
        (Broken.Payload, "Payload.messages: annotate what it returns as Iterator[Message[...]]"),
        (Broken.Loose, "Loose takes **options; name each option in its signature"),
    ],
)
def test_a_class_that_breaks_the_rules_is_told_which(cls: type[Stage], sentence: str) -> None:
    with pytest.raises(ContractError) as caught:
        contract_of(cls)
    assert str(caught.value) == sentence


def test_a_class_without_init_takes_no_options() -> None:
    assert options_of(graph_stages.Odometry) == ()


class Sized(Protocol):
    size: int


@pytest.mark.parametrize(
    ("given", "taken", "fit"),
    [
        ((GrayImage,), (Image,), True),
        ((Image,), (GrayImage,), False),
        ((Image, Scan), (Image,), False),
        ((Image, Scan), (Scan, Image), True),
        ((Any,), (Image,), True),
        ((Image,), (Any,), True),
        ((Image,), (object,), True),
        ((Image,), (Sized,), True),
    ],
)
def test_every_type_given_must_be_one_that_is_taken(
    given: tuple[Any, ...], taken: tuple[Any, ...], fit: bool
) -> None:
    assert fits(given, taken) is fit


@pytest.mark.parametrize(
    ("annotation", "name"),
    [
        (int | None, "int | None"),
        (Literal["f32", "f16"], "'f32' | 'f16'"),
        (Mapping[str, float], "Mapping[str, float]"),
        (tuple[Path, ...], "tuple[Path, ...]"),
        (Annotated[int, "words"], "int"),
        (Any, "Any"),
    ],
)
def test_a_type_is_named_as_it_is_written(annotation: Any, name: str) -> None:
    assert type_name(annotation) == name
