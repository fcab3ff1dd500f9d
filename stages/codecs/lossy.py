"""Compressors for slow links between hosts: `compress: stages.codecs.lossy:Jpeg` on an edge."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from stages.types import Image

#: 45 kB for a frame of 848 x 480 with classes laid over it; at 90 it is 80 kB.
QUALITY = 75


class Jpeg:
    """Images of 8 bits as JPEG; those of 16 bits, which JPEG cannot hold, go as they are."""

    def shrink(self, image: Image) -> Any:
        if image.data.dtype != np.uint8:
            return {"camera": image.camera, "data": image.data}
        ordered = image.data[..., ::-1] if image.data.ndim == 3 else image.data
        flags = (cv2.IMWRITE_JPEG_QUALITY, QUALITY)
        sound, data = cv2.imencode(".jpg", np.ascontiguousarray(ordered), flags)
        if not sound:
            raise ValueError(f"cannot write an image of shape {image.data.shape} as JPEG")
        return {"camera": image.camera, "jpeg": data.tobytes()}

    def restore(self, value: Any) -> Image:
        """Raises ValueError for what `shrink` never gives."""
        if not (isinstance(value, dict) and isinstance(value.get("camera"), str)):
            raise ValueError("no image")
        if isinstance(data := value.get("data"), np.ndarray):
            return Image(data, value["camera"])
        packed = value.get("jpeg")
        if not isinstance(packed, bytes) or not packed:
            raise ValueError("no JPEG")
        try:
            picture = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error as error:
            raise ValueError(str(error)) from None
        if picture is None:
            raise ValueError("a damaged JPEG")
        color = np.ascontiguousarray(picture[..., ::-1]) if picture.ndim == 3 else picture
        return Image(color.astype(np.uint8, copy=False), value["camera"])
