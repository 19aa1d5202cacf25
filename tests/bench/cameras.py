"""Corners under cameras that differ from the usual one: Bayer sensors and fisheye lenses."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np

from mobilecal_cli.readers.pictures import decode_image
from mobilecal_cli.vision import Detection, detect
from mobilecal_cli.vision.grid_map import fit_grid
from tests.bench.pictures import BOARD, View, nearest, view
from tests.bench.study import paragraph, table

_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
_LEAST_EDGE_PX = 7.0
#: What red and blue pixels see of a gray scene, against green ones.
_GAINS = ((1.0, 1.0), (0.8, 0.9), (0.5, 0.7))
_FISHEYE = {"boofcv": (6, 4), "camodocal": (9, 6)}
#: Corners that lie nearer to findChessboardCorners' are taken for the same, px.
_SAME_PX = 2.0


def _mosaic(seen: View, seed: int, red: float, blue: float) -> np.ndarray:
    """A picture as a sensor with an RGGB filter stores it."""
    signal = seen.light.copy()
    signal[::2, ::2] *= red
    signal[1::2, 1::2] *= blue
    signal += seen.noise_grey * np.random.default_rng([seed, 7]).normal(size=signal.shape)
    return np.clip(np.round(signal), 0, 255).astype(np.uint8)


def _errors(data: bytes, kind: str, seen: View) -> np.ndarray | None:
    found = detect(decode_image(SimpleNamespace(data=data, format=kind)), BOARD.columns, BOARD.rows)
    if not isinstance(found, Detection):
        return None
    corners = found.pixels.reshape(seen.truth.shape)
    return nearest(seen, corners, corners[::-1, ::-1])


def _mosaics(seed: int) -> list[list[np.ndarray | None]]:
    """One picture by every sensor: errors of its corners as stored and demosaiced; [] if its squares are too small."""
    seen = view(seed)
    if seen.edge_px < _LEAST_EDGE_PX:
        return []
    stored = [cv2.imencode(".png", _mosaic(seen, seed, *gains))[1].tobytes() for gains in _GAINS]
    kinds = "mono8; png compressed", "bayer_rggb8; png compressed"
    return [[_errors(data, kind, seen) for kind in kinds] for data in stored]


def bayer(views: int) -> str:
    """Corner errors in Bayer PNGs, with and without demosaicing."""
    with ProcessPoolExecutor() as pool:
        drawn = [some for some in pool.map(_mosaics, range(views), chunksize=5) if some]
    rows = []
    for (red, blue), tried in zip(_GAINS, zip(*drawn, strict=True), strict=True):
        counts = [sum(errors is not None for errors in each) for each in zip(*tried, strict=True)]
        both = [pair for pair in tried if pair[0] is not None and pair[1] is not None]
        rms = [float(np.sqrt(np.mean(np.stack(errors) ** 2))) for errors in zip(*both, strict=True)]
        row = [f"{red:g}, {blue:g}", *(f"{count} of {len(tried)}" for count in counts), str(len(both))]
        rows.append([*row, *(f"{value:.4f}" for value in rms)])
    head = ["red and blue against green", "found as stored", "found demosaiced", "found in both", "as stored (px)",
            "demosaiced (px)"]  # fmt: skip
    return table(head, rows)


def _wrong_sizes(columns: int, rows: int) -> Iterator[tuple[int, int]]:
    for i, j in ((-1, 0), (0, -1), (-1, -1), (1, 0), (0, 1), (1, 1), (-2, 0)):
        yield columns + i, rows + j


def fisheye() -> str:
    """Boards found under real fisheye lenses, their corners, and boards of wrong sizes."""
    rows = []
    for folder, (columns, rows_of_board) in _FISHEYE.items():
        expected = np.load(_DATA / "fisheye" / folder / "corners.npz")
        right, wrong, tried, accepted = 0, 0, 0, 0
        apart, rough = [], []
        for name in expected.files:
            image = cv2.imread(str(_DATA / "fisheye" / folder / name), cv2.IMREAD_GRAYSCALE)
            assert image is not None, name
            found = detect(image, columns, rows_of_board)
            if isinstance(found, Detection):
                distance = np.linalg.norm(found.pixels[:, None] - expected[name].reshape(1, -1, 2), axis=-1)
                nearest = distance.min(axis=1)
                same = nearest.max() < _SAME_PX and len(set(distance.argmin(axis=1))) == len(nearest)
                right, wrong = right + same, wrong + (not same)
                apart.append(nearest)
                shape = rows_of_board, columns, 2
                others = expected[name].reshape(-1, 2)[distance.argmin(axis=1)]
                grids = found.pixels.reshape(shape), others.reshape(shape)
                rough.append([fit_grid(grid, image.shape).sigma_px for grid in grids])
            sizes = list(_wrong_sizes(columns, rows_of_board))
            tried += len(sizes)
            accepted += sum(isinstance(detect(image, *size), Detection) for size in sizes)
        every = np.concatenate(apart)
        numbers = f"{np.median(every):.2f}", f"{np.sqrt(np.mean(every**2)):.2f}", f"{every.max():.2f}"
        counts = f"{right} of {len(expected.files)}", str(wrong), f"{accepted} of {tried}"
        scatter = (f"{value:.2f}" for value in np.sqrt(np.mean(np.square(rough), axis=0)))
        rows.append([f"{folder}, {columns} x {rows_of_board}", *counts, *numbers, *scatter])
    head = ["images", "found", "wrong", "wrong sizes accepted", "median distance from cornerSubPix (px)", "rms (px)",
            "largest (px)", "scatter about a smooth map (px)", "cornerSubPix's (px)"]  # fmt: skip
    return table(head, rows)


def negatives() -> str:
    """Number of boards in real images without one."""
    paths = sorted((_DATA / "stereo" / "negatives_no_board").glob("*.*g"))
    sizes = (9, 6), (6, 4), (13, 9), (7, 5), (4, 3)
    images = [image for path in paths if (image := cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) is not None]
    found = sum(isinstance(detect(image, *size), Detection) for image in images for size in sizes)
    return f"{found} of {len(images) * len(sizes)}"


def main(views: int) -> str:
    """All tables of this module."""
    text = paragraph(
        "PNGs of a Bayer sensor (RGGB) without white balance: error of the corners in images with squares of "
        f"{_LEAST_EDGE_PX:.0f} px and more, over the images in which both show the board. As stored: the mosaic taken "
        "for a gray image. Demosaiced: as `calibrate` reads it."
    ) + bayer(views)
    if not _DATA.is_dir():
        return text + "\nThe published images for the tables of fisheye lenses are not available.\n"
    return (
        f"{text}\n"
        + paragraph(
            "Real images under strong fisheye lenses, no camera model given (sets of BoofCV and CamOdoCal). Compared with "
            "findChessboardCorners and cornerSubPix, half window 5 px, of which all corners were examined. Wrong sizes: "
            "the same images, rows and columns one more or one less."
        )
        + fisheye()
        + "\n"
        + paragraph(f"Real images without a board, five sizes tried in each: {negatives()} accepted.")
    )
