"""JPEG images for the report."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model import GrayImage

_QUALITY = 85


def snapshot_jpeg(image: GrayImage) -> bytes:
    """JPEG data of a (height, width) gray image."""
    return bytes(cv2.imencode(".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])
