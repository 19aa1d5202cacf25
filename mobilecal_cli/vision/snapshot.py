"""JPEG images for the report."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model import GrayImage

_QUALITY = 85
_ACROSS, _SMALL_QUALITY = 96, 60  # of a thumbnail


def thumbnail_jpeg(image: GrayImage) -> bytes:
    """JPEG data of a (height, width) gray image, scaled down to 96 pixels across."""
    height = max(1, round(image.shape[0] * _ACROSS / image.shape[1]))
    small = cv2.resize(np.ascontiguousarray(image), (_ACROSS, height), interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _SMALL_QUALITY])[1])


def snapshot_jpeg(image: GrayImage) -> bytes:
    """JPEG data of a (height, width) gray image."""
    return bytes(cv2.imencode(".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])
