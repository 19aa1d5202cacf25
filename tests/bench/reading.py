"""Every frame of a recording without stops: reading and detection compared with reading and decoding, on one and two cores."""

import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from statistics import median

from tests.bench.study import measured, table

REPEATS = 5
_JPEG, _CORES = "jpeg", 2
_MEASURED = 100  # stations


def decode_alone(path: str, workers: str) -> float:
    """Seconds to read all messages with the `mcap` package and decode the images, on `workers` threads."""
    import cv2
    import numpy as np
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_typestore

    cv2.setNumThreads(1)
    store = get_typestore(Stores.ROS2_HUMBLE)
    waiting: deque[Future[None]] = deque()

    def picture(data: bytes, kind: str) -> None:
        message = store.deserialize_cdr(data, kind)
        if kind.endswith("CompressedImage"):
            cv2.imdecode(message.data, cv2.IMREAD_GRAYSCALE)
        else:
            np.asarray(message.data).reshape(message.height, message.width)

    start = time.perf_counter()
    with Path(path).open("rb") as stream, ThreadPoolExecutor(int(workers)) as pool:
        for schema, _, message in make_reader(stream).iter_messages():
            if schema is not None and "Image" in schema.name:
                waiting.append(pool.submit(picture, message.data, schema.name))
            while len(waiting) > 8:
                waiting.popleft().result()
        for future in waiting:
            future.result()
    return time.perf_counter() - start


def read_and_see(path: str, jobs: str) -> dict[str, float]:
    """Seconds to read the recording and search each image; ms per station to measure; number of boards found."""
    from mobilecal_cli.calibrate.detect import detect_all, plan_recording
    from mobilecal_cli.model.rig import Board
    from mobilecal_cli.readers import open_recording, read_description
    from mobilecal_cli.rig.config import load_rig
    from mobilecal_cli.rig.resolve import complete_rig, survey_rig
    from mobilecal_cli.vision import Detection, Measured, measure, resolve_square

    board = Board(9, 6, 0.08)
    start = time.perf_counter()
    with open_recording([Path(path)]) as recording:
        rig = complete_rig(survey_rig(load_rig(None), read_description(recording)))
        (plan,), *_ = plan_recording(recording, rig, True)
        (detections,) = detect_all(recording, rig, board, [plan], False, int(jobs))
    seconds = time.perf_counter() - start
    each = (d for one in detections for d in one.found.values())
    found = sum(isinstance(d, Detection) for d in each)
    start = time.perf_counter()
    for place in detections[:_MEASURED]:
        shots = place.of_shots(rig.cameras)
        if shots and isinstance(item := measure(place.station, shots, rig.cameras, board), Measured):
            resolve_square(item, board.square_m)
    measuring = 1e3 * (time.perf_counter() - start) / _MEASURED
    return {"seconds": seconds, "measuring": measuring, "found": found}


def main(logs: dict[str, Path], repeats: int = REPEATS) -> str:
    """Tables 1 and 7, for one recording with several image encodings."""
    rows: list[list[str]] = []
    speed: list[list[str]] = []
    for kind, path in logs.items():
        # One core is measured with JPEGs only: the other encodings would double the time.
        cores = (1, _CORES) if kind == _JPEG else (_CORES,)
        runs = [
            {
                f"{what}{workers}": measured(function, path, workers, OPENBLAS_NUM_THREADS="1")
                for workers in cores
                for what, function in (("decode", decode_alone), ("see", read_and_see))
            }
            for _ in range(repeats)
        ]
        for workers in cores:
            see = [run[f"see{workers}"] for run in runs]
            decode = [run[f"decode{workers}"] for run in runs]
            ratio = median(s["seconds"] / d for s, d in zip(see, decode, strict=True))
            rows.append(
                [kind, str(workers), f"{median(decode):.2f}", f"{median(s['seconds'] for s in see):.2f}", f"{ratio:.2f}",
                 f"{median(s['measuring'] for s in see):.2f}", f"{see[0]['found']:.0f}"]
            )  # fmt: skip
        if len(cores) > 1:
            gains = (
                median(run["decode1"] / run[f"decode{_CORES}"] for run in runs),
                median(run["see1"]["seconds"] / run[f"see{_CORES}"]["seconds"] for run in runs),
            )
            speed.append([kind, *(f"{gain:.2f}" for gain in gains)])
    head = ["images", "cores", "read + decode (s)", "read + detect (s)", "ratio",
            "triangulation and pose (ms per station, one core)", "boards found"]  # fmt: skip
    return (
        table(head, rows)
        + f"\nSpeed-up from 1 to {_CORES} cores, medians of the ratios of all rounds.\n\n"
        + table(["images", "read + decode", "read + detect"], speed)
    )
