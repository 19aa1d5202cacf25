"""Every picture encoding, honest sizes, and dishonest ones."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.readers import open_recording
from mobilecal_cli.readers.pictures import decode_image

from . import recordings as r

GRAY = r.picture(1)
COLOR = np.stack([GRAY, 255 - GRAY, GRAY // 2], axis=-1)
"""Red, green, blue."""
LUMA = 0.299 * COLOR[..., 0] + 0.587 * COLOR[..., 1] + 0.114 * COLOR[..., 2]
ALPHA = np.full_like(GRAY[..., None], 7)


def decoded(pixels, encoding, **changes):
    return decode_image(r.image(pixels, encoding, **changes)(r.ROS2))


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_gray_is_passed_through_without_a_copy(encoding):
    message = r.image(GRAY, encoding)(r.ROS2)
    gray = decode_image(message)
    np.testing.assert_array_equal(gray, GRAY)
    assert np.shares_memory(gray, message.data)


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("rgb8", COLOR),
        ("bgr8", COLOR[..., ::-1]),
        ("8UC3", COLOR[..., ::-1]),
        ("rgba8", np.concatenate([COLOR, ALPHA], axis=-1)),
        ("bgra8", np.concatenate([COLOR[..., ::-1], ALPHA], axis=-1)),
        ("8UC4", np.concatenate([COLOR[..., ::-1], ALPHA], axis=-1)),
        ("rgb16", COLOR.astype(np.uint16) << 8),
        ("bgr16", COLOR[..., ::-1].astype(np.uint16) << 8),
        ("16UC3", COLOR[..., ::-1].astype(np.uint16) << 8),
        ("rgba16", np.concatenate([COLOR, ALPHA], axis=-1).astype(np.uint16) << 8),
    ],
)
def test_colours_are_weighted(encoding, pixels):
    assert np.abs(decoded(pixels, encoding).astype(float) - LUMA).max() <= 1


@pytest.mark.parametrize(
    ("encodings", "pixels"),
    [
        (("yuv422", "uyvy"), np.stack([ALPHA[..., 0], GRAY], axis=-1)),
        (("yuv422_yuy2", "yuy2", "yuyv"), np.stack([GRAY, ALPHA[..., 0]], axis=-1)),
        (("nv12", "nv21"), np.concatenate([GRAY, ALPHA[:24, :, 0]])),
        (("nv24",), np.concatenate([GRAY, ALPHA[..., 0], ALPHA[..., 0]])),
    ],
)
def test_the_gray_image_of_yuv(encodings, pixels):
    for encoding in encodings:
        found = decoded(pixels, encoding, height=48, width=64, step=pixels.strides[0])
        np.testing.assert_array_equal(found, GRAY)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_16_bit_in_either_byte_order(encoding, order):
    words = (GRAY.astype(np.uint16) << 8) + 17
    gray = decoded(words.astype(f"{order}u2"), encoding, is_bigendian=int(order == ">"))
    np.testing.assert_array_equal(gray, GRAY)


@pytest.mark.parametrize("shift", [4, 8])
@pytest.mark.parametrize("color", [False, True])
def test_16_bit_png_is_scaled_like_raw_words(shift, color):
    pixels = COLOR[..., ::-1] if color else GRAY
    words = pixels.astype(np.uint16) << shift
    raw = decoded(words, "bgr16" if color else "mono16")
    np.testing.assert_array_equal(decode_image(r.compressed(words, ".png")(r.ROS2)), raw)
    assert np.ptp(raw) > 50


def test_exif_orientation_does_not_turn_an_image():
    message = r.compressed(GRAY, ".jpg")(r.ROS2)
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter turn
    upright, block = message.data.tobytes(), exif.tobytes()
    expected = decode_image(message)
    data = upright[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + upright[2:]
    assert Image.open(io.BytesIO(data)).getexif()[0x0112] == 6
    message.data = np.frombuffer(data, dtype=np.uint8)
    np.testing.assert_array_equal(decode_image(message), expected)


PATTERNS = {
    "rggb": ((0, 1), (1, 2)),
    "bggr": ((2, 1), (1, 0)),
    "gbrg": ((1, 2), (0, 1)),
    "grbg": ((1, 0), (2, 1)),
}


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_bayer_patterns(pattern, bits):
    color = np.array([200, 120, 40])
    tile = color[np.array(PATTERNS[pattern])]
    mosaic = np.tile(tile, (16, 20)).astype(np.uint8)
    pixels = mosaic if bits == 8 else mosaic.astype(np.uint16) << 8
    gray = decoded(pixels, f"bayer_{pattern}{bits}")
    assert np.abs(gray[2:-2, 2:-2] - (color @ [0.299, 0.587, 0.114])).max() <= 1
    mosaic = GRAY if bits == 8 else GRAY.astype(np.uint16) << 8
    message = r.compressed(mosaic, ".png")(r.ROS2)
    message.format = f"bayer_{pattern}{bits}; png compressed "
    np.testing.assert_array_equal(decode_image(message), decoded(mosaic, f"bayer_{pattern}{bits}"))


def test_a_bayer_image_that_was_compressed_in_color_is_not_converted_again():
    message = r.compressed(COLOR[..., ::-1], ".jpg")(r.ROS2)
    expected = decode_image(message)
    message.format = "bayer_rggb8; jpeg compressed bgr8"
    np.testing.assert_array_equal(decode_image(message), expected)


def test_rows_with_padding():
    padded = np.pad(COLOR.reshape(48, -1), ((0, 0), (0, 13)), constant_values=99)
    gray = decoded(padded, "rgb8", width=64, step=64 * 3 + 13)
    assert np.abs(gray.astype(float) - LUMA).max() <= 1
    padded = np.pad(GRAY, ((0, 0), (0, 6))).ravel()[:-6].reshape(1, -1)
    np.testing.assert_array_equal(decoded(padded, "mono8", height=48, width=64, step=70), GRAY)


@pytest.mark.parametrize("extension", [".png", ".jpg"])
@pytest.mark.parametrize("pixels", [GRAY, COLOR[..., ::-1]], ids=["gray", "colour"])
def test_compressed(extension, pixels):
    gray = decode_image(r.compressed(pixels, extension)(r.ROS1))
    expected = GRAY if pixels is GRAY else LUMA
    assert gray.dtype == np.uint8
    assert np.abs(gray.astype(float) - expected).mean() < (3 if extension == ".jpg" else 0.6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"height": 4000}, "size 64x4000 mono8 with 64 bytes per row does not match its 3072 bytes"),
        ({"step": 10}, "10 bytes per row"),
        ({"width": 0}, "invalid image size"),
        ({"width": 2**32 - 1, "height": 2**32 - 1}, "invalid image size"),
        ({"encoding": "yuv999"}, "unknown image encoding 'yuv999'"),
        ({"encoding": "32FC1"}, "unknown image encoding '32FC1': a depth or disparity image"),
        ({"encoding": "nv12"}, "size 64x48 nv12 with 64 bytes per row does not match its 3072 bytes"),
        ({"encoding": "rgb8"}, "does not match"),
    ],
)
def test_dishonest_pictures_are_refused(changes, message):
    with pytest.raises(RecordingError, match=message):
        decoded(GRAY, changes.pop("encoding", "mono8"), **changes)


PNG, BMP = (cv2.imencode(kind, GRAY)[1].tobytes() for kind in (".png", ".bmp"))
LARGEST = (2**31 - 1).to_bytes(4, "big")


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff\xd8\xff\xe0 not a jpeg", PNG[:8] + bytes(30), PNG[:16] + LARGEST + LARGEST + PNG[24:], BMP],
)
def test_damaged_compressed_pictures_and_other_kinds_are_refused(data):
    message = r.compressed(GRAY, ".png")(r.ROS2)
    message.data = np.frombuffer(data, dtype=np.uint8)
    with pytest.raises(RecordingError, match=r"image (empty|damaged, or not JPEG or PNG: )"):
        decode_image(message)


def test_undecodable_picture_is_a_rejection_in_its_place(tmp_path):
    items = [
        r.Item("/l", r.START_NS + k, r.image(GRAY, encoding, r.START_NS + k))
        for k, encoding in enumerate(["mono8", "yuv999", "mono8", "mono8"])
    ]
    with open_recording([r.write_mcap(tmp_path / "log.mcap", items)]) as recording:
        wanted = {"left": [r.START_NS + k for k in range(3)]}
        found = list(r.read_images(recording, {"left": "/l", "right": "/r"}, wanted))
    assert [(s, ns - r.START_NS) for s, ns, _ in found] == [("left", 0), ("left", 1), ("left", 2)]
    rejection = found[1][2]
    assert isinstance(rejection, Rejection)
    assert (rejection.stage, rejection.reason) == ("readers", "image cannot be decoded")
    assert "/l: unknown image encoding 'yuv999'" in rejection.detail
    assert rejection.time_ns == r.START_NS + 1
    np.testing.assert_array_equal(found[2][2], GRAY)


@pytest.mark.parametrize(("layout", "axis"), [("side_by_side", 1), ("stacked", 0)])
def test_two_cameras_in_one_picture(tmp_path, layout, axis):
    other = 255 - GRAY
    both = np.concatenate([GRAY, other], axis=axis)
    items = [r.Item("/both", r.START_NS, r.image(both, "mono8", r.START_NS))]
    images = {"left": "/both", "right": "/both"}
    with open_recording([r.write_mcap(tmp_path / "log.mcap", items)]) as recording:
        wanted = {"left": [r.START_NS], "right": [r.START_NS]}
        found = {side: picture for side, _, picture in r.read_images(recording, images, wanted, layout)}
    np.testing.assert_array_equal(found["left"], GRAY)
    np.testing.assert_array_equal(found["right"], other)
