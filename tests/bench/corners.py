"""Corner errors against the truth and the bound, compared with the detectors and refinement of OpenCV."""

import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model.rig import Board
from mobilecal_cli.vision import BoardFollower, Detection, detect
from mobilecal_cli.vision.corner_model import fit_corners, refine_widely
from mobilecal_cli.vision.values import Appearance
from tests.bench import cameras
from tests.bench.pictures import BOARD, View, bound_px, empty, nearest, shortest_edge_px, view
from tests.bench.study import paragraph, table
from tests.vision.scenes import bouguet

VIEWS = 120
EMPTY = 40
_EDGES = ((7.0, 9.0), (9.0, 12.0), (12.0, 20.0), (20.0, 99.0))
_TONES = (
    ("linear", 0), ("gamma 1/2.2", 0), ("saturated (x 1.6)", 0), ("crushed blacks", 0),
    ("linear", 90), ("linear", 75), ("linear", 50),
)  # fmt: skip
_START_PX = 0.3
_DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "stereo"


def sub_pix(image: np.ndarray, corners: np.ndarray, most: int = 11) -> np.ndarray:
    """cornerSubPix with a window that follows the smallest square, as good as it gets: (rows, columns, 2) px."""
    half = int(np.clip(0.5 * shortest_edge_px(corners) - 0.5, 2, most))
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    start = corners.reshape(-1, 1, 2).astype(np.float32)
    found = cv2.cornerSubPix(image, start, (half, half), (-1, -1), until)
    return np.asarray(found, float).reshape(corners.shape)


def ours(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The product's refinement and fit from the same start."""
    edge = shortest_edge_px(corners)
    start = refine_widely(image, refine_widely(image, corners, edge, True), edge, True)
    return fit_corners(image, start, Appearance()).pixels.reshape(corners.shape)


@dataclass(frozen=True)
class Errors:
    """Squared errors of one picture's corners, per coordinate, and the bound's, by how they were found."""

    edge_px: float
    squares: dict[str, np.ndarray]


def errors_of(seen: View, image: np.ndarray, seed: int, noise_grey: float | None = None) -> Errors:
    """Both refinements from one start, beside the bound."""
    start = seen.truth + _START_PX * np.random.default_rng([seed, 9]).normal(size=seen.truth.shape)
    hows = {"cornerSubPix": sub_pix, "mobilecal": ours}
    squares = {name: (how(image, start) - seen.truth) ** 2 for name, how in hows.items()}
    bound = np.repeat(bound_px(seen, noise_grey)[..., None] ** 2, 2, axis=-1)
    return Errors(seen.edge_px, squares | {"bound": bound})


def rms(found: Iterable[Errors], name: str) -> float:
    """Root mean square over all corners and both coordinates, px."""
    return float(np.sqrt(np.mean(np.concatenate([errors.squares[name].ravel() for errors in found]))))


def _random(seed: int) -> Errors:
    seen = view(seed)
    return errors_of(seen, seen.taken(seed), seed)


_FIXED = [("blur", v, "px") for v in (0.5, 0.8, 1.2, 2.0)]
_FIXED += [("noise", v, "gray") for v in (0.5, 1.0, 2.0, 4.0)]


def _cases(seed: int) -> dict[str, Errors]:
    """One pose at fixed blurs and noises, and with its own ones by every tone curve."""
    found = {}
    for what, value, unit in _FIXED:
        seen = view(seed, value if what == "blur" else 0.8)
        noise = value if what == "noise" else 2.0
        found[f"{what} {value} {unit}"] = errors_of(seen, seen.taken(seed, noise_grey=noise), seed, noise)
    seen = view(seed)
    for tone, jpeg in _TONES:
        name = tone if not jpeg else f"JPEG, quality {jpeg}"
        found[name] = errors_of(seen, seen.taken(seed, tone=tone, jpeg=jpeg), seed)
    return found


def _lines(found: dict[str, list[Errors]]) -> list[list[str]]:
    return [
        [name, str(len(some)), *(f"{rms(some, how):.4f}" for how in ("bound", "mobilecal", "cornerSubPix"))]
        for name, some in found.items()
        if some
    ]


_HEAD = ["", "images", "bound (px)", "mobilecal (px)", "cornerSubPix (px)"]


def accuracy(views: int) -> str:
    """Errors by size of squares, blur, noise, tone curve and JPEG quality."""
    with ProcessPoolExecutor() as pool:
        drawn = list(pool.map(_random, range(views), chunksize=5))
        large = [e for e in drawn if e.edge_px >= _EDGES[0][0]]
        tried = list(pool.map(_cases, range(max(views // 4, 12)), chunksize=2))
    by_size, by_case = {}, {}
    for a, b in _EDGES:
        by_size[f"squares of {a:.0f} to {b:.0f} px"] = [e for e in large if a <= e.edge_px < b]
    for name in tried[0]:
        by_case[name] = [case[name] for case in tried if case[name].edge_px >= _EDGES[0][0]]
    rows = _lines({"all, squares of 7 px and more": large} | by_size | by_case)
    return table(_HEAD, rows)


@dataclass(frozen=True)
class _Found:
    right: bool
    wrong: bool
    squares: np.ndarray
    seconds: float


Finder = Callable[[np.ndarray], np.ndarray | None]


def _classic(image: np.ndarray, flags: int) -> np.ndarray | None:
    found, corners = cv2.findChessboardCorners(image, (BOARD.columns, BOARD.rows), flags=flags)
    return np.asarray(corners, float).reshape(BOARD.rows, BOARD.columns, 2) if found else None


def _sectors(image: np.ndarray) -> np.ndarray | None:
    found, corners = cv2.findChessboardCornersSB(image, (BOARD.columns, BOARD.rows), flags=0)
    return np.asarray(corners, float).reshape(BOARD.rows, BOARD.columns, 2) if found else None


def _refined(find: Finder) -> Finder:
    def run(image: np.ndarray) -> np.ndarray | None:
        corners = find(image)
        return None if corners is None else sub_pix(image, corners)

    return run


def _product(image: np.ndarray) -> np.ndarray | None:
    found = detect(image, BOARD.columns, BOARD.rows)
    return found.pixels.reshape(BOARD.rows, BOARD.columns, 2) if isinstance(found, Detection) else None


_USUAL = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
FINDERS: dict[str, Finder] = {
    "mobilecal": _product,
    "findChessboardCorners, usual flags": lambda image: _classic(image, _USUAL),
    "findChessboardCorners, usual flags, cornerSubPix": _refined(lambda image: _classic(image, _USUAL)),
    "findChessboardCorners, no flags, cornerSubPix": _refined(lambda image: _classic(image, 0)),
    "findChessboardCornersSB": _sectors,
    "findChessboardCornersSB, cornerSubPix": _refined(_sectors),
}


def _judged(find: Finder, seen: View, image: np.ndarray) -> _Found:
    start = time.process_time()
    corners = find(image)
    seconds = time.process_time() - start
    if corners is None:
        return _Found(False, False, np.zeros(0), seconds)
    # Which corner comes first is a matter of convention: the nearest of the four ways counts.
    off = nearest(seen, corners, corners[::-1, ::-1], corners[:, ::-1], corners[::-1])
    right = bool(np.linalg.norm(off, axis=-1).max() <= max(2.0, 0.3 * seen.edge_px))
    return _Found(right, not right, off**2 if right else np.zeros(0), seconds)


def _row(name: str, found: list[_Found], without: list[tuple[bool, float]]) -> list[str]:
    right = [f for f in found if f.right]
    wrong = sum(f.wrong for f in found) + sum(there for there, _ in without)
    error = np.sqrt(np.mean(np.concatenate([f.squares.ravel() for f in right])))
    times = np.median([f.seconds for f in right]), np.median([seconds for _, seconds in without])
    ms = (f"{1e3 * t:.1f}" for t in times)
    return [name, f"{len(right)} of {len(found)}", str(wrong), f"{error:.3f}", *ms]


def _empty_times(find: Finder, image: np.ndarray) -> tuple[bool, float]:
    start = time.process_time()
    return find(image) is not None, time.process_time() - start


def _followed(seed: int, seen: View) -> _Found | None:
    """The same picture one pixel further on, as the next frame of a film; None where the first one shows no board."""
    follower = BoardFollower(Board(BOARD.columns, BOARD.rows, BOARD.square_m), thorough=False)
    if not isinstance(follower.find(seen.taken(seed), 0), Detection):
        return None

    def find(image: np.ndarray) -> np.ndarray | None:
        found = follower.find(image, 50_000_000)
        return found.pixels.reshape(seen.truth.shape) - 1 if isinstance(found, Detection) else None

    return _judged(find, seen, np.roll(seen.taken(seed + 100_000), (1, 1), axis=(0, 1)))


def detectors(views: int) -> str:
    """What is found, how well, and at what cost, of pictures with squares of 7 px and more."""
    cv2.setNumThreads(1)
    found: dict[str, list[_Found]] = {name: [] for name in FINDERS}
    followed = []
    for seed in range(views):
        seen = view(seed)
        if seen.edge_px < _EDGES[0][0]:
            continue
        for name, find in FINDERS.items():
            found[name].append(_judged(find, seen, seen.taken(seed)))
        followed.append(_followed(seed, seen))
    walls = [empty(seed) for seed in range(EMPTY)]
    rows = []
    for name, find in FINDERS.items():
        rows.append(_row(name, found[name], [_empty_times(find, wall) for wall in walls]))
    tracked = [f for f in followed if f is not None]
    again = _row("mobilecal, tracked from the last image", tracked, [(False, 0.0)])
    rows.insert(1, [*again[:-1], ""])
    head = ["", "found", "wrong", "error (px)", "ms per image with a board", "ms per image without a board"]
    return table(head, rows)


_HALF_WINDOWS = (3, 5, 11)  # the tutorials' is 11; boards whose outer squares are narrow stand 3

_PAIR = bouguet()


def _flat_px(corners: np.ndarray, side: int) -> np.ndarray:
    """(M, 2) corners without the lens' distortion, px."""
    camera = _PAIR.each[side]
    return cv2.undistortPoints(corners.reshape(-1, 1, 2), camera.K, camera.D, P=camera.K).reshape(-1, 2)


def _homography_px(flat: np.ndarray, columns: int, rows: int) -> float:
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(float)
    H = cv2.findHomography(grid, flat)[0]
    off = cv2.perspectiveTransform(grid[:, None], H)[:, 0] - flat
    return float(np.mean(off**2))


def _epipolar_px(left: np.ndarray, right: np.ndarray) -> float:
    """Mean square of Sampson's distance of pairs without distortion."""
    T_r_c = se3.inverse(_PAIR.T_c_each[1])
    in_left, in_right = (np.linalg.inv(camera.K) for camera in _PAIR.each)
    F = in_right.T @ se3.skew(T_r_c[:3, 3]) @ T_r_c[:3, :3] @ in_left
    a, b = (np.column_stack([p, np.ones(len(p))]) for p in (left, right))
    lines_b, lines_a = a @ F.T, b @ F
    against = np.sum(b * lines_b, axis=1) ** 2
    return float(np.mean(against / (lines_a[:, :2] ** 2 + lines_b[:, :2] ** 2).sum(axis=1)))


def real_pairs() -> str:
    """Residuals on Bouguet's seven stereo pairs, and of MRPT's four (no calibration is published: homography only)."""
    if not _DATA.is_dir():
        return "The published images for this table are not available.\n"
    rows = []
    for name, folder, calibrated in (
        ("pairs from Bouguet", "opencv_samples", True),
        ("pairs from MRPT", "mrpt_stereo_calib", False),
    ):
        hows = ("mobilecal", *(f"cornerSubPix, half window {most} px" for most in _HALF_WINDOWS))
        squares: dict[str, list[float]] = {how: [] for how in hows}
        epipolar: dict[str, list[float]] = {how: [] for how in hows}
        for first in sorted((_DATA / folder).rglob("*left*.jpg")):
            paths = first, first.with_name(first.name.replace("left", "right"))
            pair = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
            found = [detect(image, 9, 6) for image in pair if image is not None]
            if len(found) < 2 or not all(isinstance(d, Detection) for d in found):
                continue
            corners = [d.pixels.reshape(6, 9, 2) for d in found if isinstance(d, Detection)]
            both = list(zip(pair, corners, strict=True))
            others = [[sub_pix(i, c, most) for i, c in both] for most in _HALF_WINDOWS]
            for how, some in zip(hows, (corners, *others), strict=True):
                flat = [_flat_px(c, side) if calibrated else c.reshape(-1, 2) for side, c in enumerate(some)]
                squares[how] += [_homography_px(f, 9, 6) for f in flat]
                if calibrated:
                    epipolar[how].append(_epipolar_px(*flat))
        for how in hows:
            across = f"{np.sqrt(np.mean(epipolar[how])):.4f}" if calibrated else ""
            residual = f"{np.sqrt(np.mean(squares[how])):.4f}"
            rows.append([f"{name}, {how}", str(len(squares[how])), residual, across])
    return table(["", "images", "homography residual (px)", "epipolar residual (px)"], rows)


def main(views: int = VIEWS) -> str:
    """All tables of corners."""
    return "".join(
        [
            paragraph(
                f"Root-mean-square error of one coordinate; {views} random images, those with squares of 7 px and more."
            ),
            accuracy(views) + "\n",
            paragraph(
                "The bound uses no knowledge of the light. The fit estimates one gradient of the light over the board, so "
                "its error can be slightly below the bound for small squares. The row with a blur of 2.0 px contains boards "
                "whose squares are narrower than the blur. The detector rejects such boards; here, they were fitted "
                "nevertheless."
            ),
            paragraph(
                f"Detectors on the same images with squares of 7 px and more, and on {EMPTY} images without a board. The "
                "error is that of the boards found; times are medians of processor time."
            ),
            detectors(views) + "\n",
            paragraph("Real stereo pairs. The homography residual for MRPT includes the lens distortion."),
            real_pairs() + "\n",
            cameras.main(views // 2),
        ]
    )
