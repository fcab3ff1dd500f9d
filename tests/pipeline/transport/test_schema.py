"""Schemas: a stream declares its classes, and both ends must have the same."""

from __future__ import annotations

from dataclasses import make_dataclass
from typing import Any

import numpy as np
import pytest
from wire_payloads import Box, Color, Even, Mode, Scene

from pipeline.errors import TransportError
from pipeline.transport.schema import PayloadSchema, class_name


def test_a_schema_holds_every_class_that_annotations_reach_and_no_other() -> None:
    schema = PayloadSchema.of([Scene | None])
    assert set(schema.classes.values()) == {Scene, Box, Color, Mode}
    assert all(schema.classes[class_name(kind)] is kind for kind in (Scene, Box, Color, Mode))


def test_plain_values_declare_no_class() -> None:
    assert not PayloadSchema.of([Any, int, np.ndarray, tuple[int, ...], bytes]).classes


def test_the_order_of_types_does_not_change_the_hash() -> None:
    assert PayloadSchema.of([Even, Box]).hash == PayloadSchema.of([Box, Even]).hash
    assert PayloadSchema.of([Even]).hash != PayloadSchema.of([Box]).hash


@pytest.mark.parametrize(
    "fields",
    [
        [("number", "str")],
        [("count", "int")],
        [("number", "int"), ("more", "int")],
        [],
    ],
)
def test_a_changed_field_changes_the_hash(fields: list[tuple[str, str]]) -> None:
    changed = make_dataclass("Even", fields, frozen=True, namespace={"__module__": "wire_payloads"})
    changed.__module__ = "wire_payloads"
    assert class_name(changed) == class_name(Even)
    assert PayloadSchema.of([changed]).hash != PayloadSchema.of([Even]).hash


def test_an_annotation_that_cannot_be_read_names_its_class_and_the_way_out() -> None:
    unreadable = make_dataclass("Unreadable", [("x", "Nowhere")], frozen=True)
    with pytest.raises(TransportError, match=r"Unreadable.*Nowhere.*import"):
        PayloadSchema.of([unreadable])


def test_two_classes_of_one_name_are_refused() -> None:
    one, other = (make_dataclass("Twin", [(name, int)], frozen=True) for name in "ab")
    with pytest.raises(TransportError, match="two classes"):
        PayloadSchema.of([one, other])
