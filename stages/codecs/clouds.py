"""Scans and voxel maps as point clouds; lossless."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording import foxglove
from pipeline.recording.codec import Schema
from stages.labels import LabeledVoxels
from stages.types import Scan


class ScanCodec:
    """Points with remission; the times of an organized scan once per column.

    Remission that came in 8 bit stays in 8 bit (value / 255).
    """

    @property
    def schema(self) -> Schema:
        return foxglove.schema("PointCloud")

    def encode(self, message: Message[Scan]) -> bytes:
        scan = message.payload
        columns: list[tuple[str, NDArray[Any]]] = [
            (name, scan.points[:, axis]) for axis, name in enumerate("xyz")
        ]
        if scan.remission is not None:
            counts = np.round(scan.remission * np.float32(255)).clip(0, 255).astype(np.uint8)
            whole = np.array_equal(counts / np.float32(255), scan.remission)
            columns.append(("remission", counts if whole else scan.remission))
        proto = foxglove.new("PointCloud")
        if scan.shape is not None:
            proto.rows, proto.columns = scan.shape
        if scan.times_ns is not None:
            by_column = scan.times_ns.reshape(scan.shape) if scan.shape is not None else None
            if by_column is not None and (by_column == by_column[0]).all():
                proto.column_times_ns.extend(by_column[0].tolist())
            else:
                columns.append(("time_ns", scan.times_ns))
        return pack_points(proto, message, scan.sensor, columns)

    def decode(self, data: bytes, received: int) -> Message[Scan]:
        proto, table = _decode(data)
        names = table.dtype.names or ()
        points = np.stack([table[axis] for axis in "xyz"], axis=1)
        remission = table["remission"] if "remission" in names else None
        if remission is not None and remission.dtype == np.uint8:
            remission = remission / np.float32(255)
        shape = (int(proto.rows), int(proto.columns)) if proto.rows else None
        times: NDArray[np.int32] | None = None
        if "time_ns" in names:
            times = np.ascontiguousarray(table["time_ns"])
        elif proto.column_times_ns and shape is not None:
            times = np.tile(np.array(proto.column_times_ns, dtype=np.int32), shape[0])
        if shape is not None and (
            shape[0] * shape[1] != len(points) or (times is not None and len(times) != len(points))
        ):
            raise DataError(f"damaged scan: {len(points)} points are not {shape[0]} x {shape[1]}")
        if remission is not None:
            remission = np.array(remission, dtype=np.float32)
        for array in (points, remission, times):
            if array is not None:
                array.flags.writeable = False
        scan = Scan(
            points=points,
            remission=remission,
            times_ns=times,
            shape=shape,
            sensor=proto.frame_id,
        )
        return _message(proto, received, scan)


class VoxelsCodec:
    """Labeled voxels as their centers, with the class."""

    @property
    def schema(self) -> Schema:
        return foxglove.schema("PointCloud")

    def encode(self, message: Message[LabeledVoxels]) -> bytes:
        voxels = message.payload
        centers = ((voxels.indices + 0.5) * voxels.voxel_m).astype(np.float32)
        columns: list[tuple[str, NDArray[Any]]] = [
            (name, centers[:, axis]) for axis, name in enumerate("xyz")
        ]
        proto = foxglove.new("PointCloud")
        proto.voxel_m = voxels.voxel_m
        return pack_points(proto, message, "map", [*columns, ("label", voxels.classes)])

    def decode(self, data: bytes, received: int) -> Message[LabeledVoxels]:
        proto, table = _decode(data)
        if "label" not in (table.dtype.names or ()) or not proto.voxel_m > 0:
            raise DataError("damaged map: a point cloud without labels of voxels")
        centers = np.stack([table[axis] for axis in "xyz"], axis=1)
        places = np.floor(centers / np.float64(proto.voxel_m))
        if not (np.abs(places) < 2**31).all():
            raise DataError("damaged map: a voxel lies nowhere")
        indices = places.astype(np.int32)
        classes = np.ascontiguousarray(table["label"])
        indices.flags.writeable = classes.flags.writeable = False
        return _message(proto, received, LabeledVoxels(proto.voxel_m, indices, classes))


def pack_points(
    proto: Any,
    message: Message[Any],
    frame: str,
    columns: list[tuple[str, NDArray[Any]]],
    payload: bytes | None = None,
) -> bytes:
    """Pack columns of equal length as a cloud's points, with the payload beside them."""
    kinds = np.dtype([(name, values.dtype) for name, values in columns])
    table = np.empty(len(columns[0][1]), dtype=kinds)
    for name, values in columns:
        table[name] = values
        offset = kinds.fields[name][1]  # type: ignore[index]
        proto.fields.add(name=name, offset=offset, type=foxglove.NUMERIC[values.dtype.str[1:]])
    foxglove.put_times(proto, message)
    proto.frame_id, proto.point_stride = frame, kinds.itemsize
    proto.pose.orientation.w = 1.0
    return foxglove.with_data(proto, table.view(np.uint8), payload)


def _decode(data: bytes) -> tuple[Any, NDArray[Any]]:
    """The message and its points as a structured array."""
    kinds = {number: kind for kind, number in foxglove.NUMERIC.items()}
    try:
        proto = foxglove.parse("PointCloud", data)
        table = np.frombuffer(
            proto.data,
            dtype=np.dtype(
                {
                    "names": [field.name for field in proto.fields],
                    "formats": [f"<{kinds[field.type]}" for field in proto.fields],
                    "offsets": [field.offset for field in proto.fields],
                    "itemsize": proto.point_stride,
                }
            ),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"damaged point cloud ({error})") from error
    if not {"x", "y", "z"} <= set(table.dtype.names or ()):
        raise DataError("damaged point cloud: x, y or z is missing")
    return proto, table


def _message(proto: Any, received: int, payload: Any) -> Message[Any]:
    stamp, begin, end = foxglove.times(proto)
    return Message.at(stamp, payload, begin=begin, end=end, received=received)
