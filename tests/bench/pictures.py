"""Pictures of boards whose corners are known, for the study of corners; rendered by the tests' own renderer."""

import math
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from scipy.special import erf

from mobilecal_cli import se3
from mobilecal_cli.model.rig import Board, Camera
from tests.vision.scenes import opencv_pixels, painted, stereo_rig

BOARD = Board(9, 6, 0.05)
CAMERA = stereo_rig("raw").each[0]
_MARGIN_PX = 3.0
# The lens blurs what the pixels then average: a picture that is blurred after it was sampled has edges whose shape
# depends on where they lie between the pixels, and shifts corners by 0.01 px. So it is drawn so many times as fine, by
# so many rays each way.
_FINER, _SUPERSAMPLE = 4, 3
_NEARER_SQUARES = 1.3  # the board's print reaches so far beyond its corners


@dataclass(frozen=True)
class View:
    """One picture before noise.

    Attributes:
        light: (480, 640) gray levels, blurred.
        truth: (6, 9, 2) corners, px.
        edge_px: the shortest side of a square.
        blur_px: sigma of the edges' blur, a pixel's own width included.
        noise_grey: sigma of the noise that goes with it.
        half_contrast: (6, 9) half of the step from dark to light at each corner, gray levels.
    """

    light: np.ndarray
    truth: np.ndarray
    edge_px: float
    blur_px: float
    noise_grey: float
    half_contrast: np.ndarray

    def taken(
        self, seed: int, *, noise_grey: float | None = None, tone: str = "linear", jpeg: int = 0
    ) -> np.ndarray:
        """A picture with noise, in whole gray levels, after a tone curve and JPEG at a quality (0: none)."""
        noise = self.noise_grey if noise_grey is None else noise_grey
        signal = self.light + noise * np.random.default_rng([seed, 7]).normal(size=self.light.shape)
        curves = {
            "linear": lambda x: x,
            "gamma 1/2.2": lambda x: 255 * np.clip(x / 255, 0, None) ** (1 / 2.2),
            "saturated (x 1.6)": lambda x: 1.6 * x,
            "crushed blacks": lambda x: 1.3 * (x - 58),
        }
        image = np.clip(np.round(curves[tone](signal)), 0, 255).astype(np.uint8)
        if jpeg:
            coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1]
            image = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)
        return image


def nearest(seen: View, *ways: np.ndarray) -> np.ndarray:
    """The errors of found corners, px, counted in the way that comes nearest to the truth."""
    return min((way - seen.truth for way in ways), key=lambda error: float(np.abs(error).max()))


def shortest_edge_px(corners: np.ndarray) -> float:
    """The shortest side of a square, of (rows, columns, 2) corners."""
    return min(float(np.linalg.norm(np.diff(corners, axis=axis), axis=-1).min()) for axis in (0, 1))


def clutter(random: np.random.Generator) -> np.ndarray:
    """A wall with boxes, discs and stripes on it, (480, 640) gray levels."""
    wall = np.full((480, 640), random.uniform(70, 160))
    for _ in range(12):
        x, y, grey = int(random.integers(640)), int(random.integers(480)), random.uniform(20, 230)
        kind = random.integers(3)
        if kind == 0:
            end = x + int(random.integers(15, 150)), y + int(random.integers(15, 120))
            cv2.rectangle(wall, (x, y), end, grey, -1)
        elif kind == 1:
            cv2.circle(wall, (x, y), int(random.integers(8, 60)), grey, -1)
        else:
            wide, high = int(random.integers(6, 20)), int(random.integers(40, 160))
            for k in range(6):
                cv2.rectangle(wall, (x + 2 * k * wide, y), (x + (2 * k + 1) * wide, y + high), grey, -1)
    return wall


def _pose(random: np.random.Generator) -> np.ndarray:
    """T_c_k of a board that is wholly in the picture, 0.6 to 3 m away, tilted by up to 60 degrees."""
    side = BOARD.square_m or 0.0
    middle = side * np.array([(BOARD.columns - 1) / 2, (BOARD.rows - 1) / 2, 0.0])
    corners = [(i, j, 0.0) for i in (-_NEARER_SQUARES, BOARD.columns - 1 + _NEARER_SQUARES)
               for j in (-_NEARER_SQUARES, BOARD.rows - 1 + _NEARER_SQUARES)]  # fmt: skip
    while True:
        z, way = random.uniform(0.6, 3.0), random.uniform(-math.pi, math.pi)
        tilt = math.radians(random.uniform(0, 60))
        R = se3.exp_so3(tilt * np.array([math.cos(way), math.sin(way), 0.0]))
        R = R @ se3.exp_so3(np.array([0.0, 0.0, random.uniform(-0.5, 0.5)]))
        at = z * np.array([random.uniform(-0.5, 0.5), random.uniform(-0.4, 0.4), 1.0])
        T = se3.transform(R, at - R @ middle)
        outline = se3.act(T, side * np.array(corners))
        if outline[:, 2].min() < 0.2:
            continue
        pixels = opencv_pixels(CAMERA, outline)
        if pixels.min() >= _MARGIN_PX and np.all(pixels.max(axis=0) <= np.array([639, 479]) - _MARGIN_PX):
            return T


@cache
def _finer(camera: Camera) -> Camera:
    """The same camera with smaller pixels."""
    K = camera.K * [[_FINER], [_FINER], [1]]
    K[:2, 2] += (_FINER - 1) / 2  # (0, 0) is the middle of the first pixel
    return replace(camera, K=K, width=_FINER * camera.width, height=_FINER * camera.height)


def view(seed: int, blur_px: float | None = None) -> View:
    """A view with light, blur, noise and background drawn at random; `blur_px` instead of a drawn blur of the lens."""
    random = np.random.default_rng(seed)
    T = _pose(random)
    side = BOARD.square_m or 0.0
    light, dark = random.uniform(130, 225), random.uniform(15, 60)
    wall = cv2.resize(clutter(random), None, fx=_FINER, fy=_FINER, interpolation=cv2.INTER_NEAREST)
    tones = {"dark": dark, "light": light}
    picture = painted(_finer(CAMERA), T, BOARD, side, picture=wall, supersample=_SUPERSAMPLE, **tones)
    lens = random.uniform(0.5, 1.2) if blur_px is None else blur_px
    noise = random.uniform(1, 4)
    picture = cv2.GaussianBlur(picture, (0, 0), _FINER * lens, borderType=cv2.BORDER_REPLICATE)
    blurred = cv2.resize(picture, None, fx=1 / _FINER, fy=1 / _FINER, interpolation=cv2.INTER_AREA)
    x, y = np.meshgrid(np.linspace(-1, 1, 640), np.linspace(-1, 1, 480))
    falls, sinks = random.uniform(-0.3, 0.3), random.uniform(-0.2, 0.2)
    shade = (1 + falls * x) * (1 + sinks * y)
    truth = opencv_pixels(CAMERA, se3.act(T, side * BOARD.grid())).reshape(BOARD.rows, BOARD.columns, 2)
    there = np.round(truth).astype(int)
    half = (light - dark) / 2 * shade[there[..., 1], there[..., 0]]
    return View(
        blurred * shade, truth, shortest_edge_px(truth), math.hypot(lens, 1 / math.sqrt(12)), noise, half
    )


def empty(seed: int) -> np.ndarray:
    """A picture without a board."""
    random = np.random.default_rng([seed, 3])
    light = cv2.GaussianBlur(clutter(random), (0, 0), random.uniform(0.5, 1.2))
    light += random.uniform(1, 4) * random.normal(size=light.shape)
    return np.clip(np.round(light), 0, 255).astype(np.uint8)


def bound_px(seen: View, noise_grey: float | None = None) -> np.ndarray:
    """Cramer-Rao bound of each corner: (6, 9) root mean square over x and y, px.

    For ``m + a erf(d1 / sqrt(2) s) erf(d2 / sqrt(2) s) + g . p`` with all nine numbers unknown, white noise (with that
    of rounding), and a window up to the middle of each neighboring square.
    """
    noise = math.hypot(seen.noise_grey if noise_grey is None else noise_grey, 1 / math.sqrt(12))
    along, down = np.gradient(seen.truth, axis=1), np.gradient(seen.truth, axis=0)
    bound = np.empty(seen.truth.shape[:2])
    for j, i in np.ndindex(*bound.shape):
        steps = np.column_stack([along[j, i], down[j, i]])
        reach = int(np.ceil(0.5 * np.abs(steps).sum(axis=1).max())) + 1
        dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(float)
        off = np.stack([dx, dy], axis=-1).reshape(-1, 2) + np.round(seen.truth[j, i]) - seen.truth[j, i]
        inside = np.all(np.abs(off @ np.linalg.inv(steps).T) < 0.5, axis=1)
        normals = np.array([[-along[j, i, 1], along[j, i, 0]], [-down[j, i, 1], down[j, i, 0]]])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        start = np.concatenate([[0.0, 0.0], np.arctan2(normals[:, 1], normals[:, 0]), [seen.blur_px]])

        def edges(p: np.ndarray, off: np.ndarray = off[inside]) -> np.ndarray:
            d = [(off - p[:2]) @ [math.cos(p[k]), math.sin(p[k])] for k in (2, 3)]
            return erf(d[0] / (math.sqrt(2) * p[4])) * erf(d[1] / (math.sqrt(2) * p[4]))

        step = 1e-4 * np.eye(5)
        slopes = [(edges(start + s) - edges(start - s)) / 2e-4 * seen.half_contrast[j, i] for s in step]
        J = np.column_stack([*slopes, edges(start), np.ones(int(inside.sum())), off[inside]])
        covariance = noise**2 * np.linalg.pinv(J.T @ J)
        bound[j, i] = math.sqrt((covariance[0, 0] + covariance[1, 1]) / 2)
    return bound
