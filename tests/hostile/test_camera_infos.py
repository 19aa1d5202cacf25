"""A camera_info that does not belong to the images: named, and the result within 4 sigmas of the truth."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.model import Parameters
from tests.command import run
from tests.commands.edited import edited
from tests.truth import truth_of

LEFT = "/stereo/left/image_raw/compressed"


def shifted(topic, message):
    """The left image moved by 20 px."""
    if topic != LEFT:
        return message
    image = np.roll(cv2.imdecode(np.asarray(message.data), cv2.IMREAD_GRAYSCALE), 20, axis=1)
    return replace(message, data=cv2.imencode(".jpg", image)[1].reshape(-1))


def longer(topic, message):
    """Focal lengths 3 % too long."""
    if not hasattr(message, "k"):
        return message
    k, p = message.k.copy(), message.p.copy()
    k[[0, 4]] *= 1.03
    p[[0, 3, 5]] *= 1.03
    return replace(message, k=k, p=p)


def aside(topic, message):
    """The principal point of the right camera 20 px to the side."""
    if topic != "/stereo/right/camera_info":
        return message
    return replace(message, k=message.k + np.eye(9)[2] * 20)


@pytest.mark.long
@pytest.mark.parametrize(
    ("edit", "named"),
    [
        (shifted, "Left camera: principal point, x"),
        (longer, "Left camera: focal length"),
        (aside, "Right camera: principal point, x"),
    ],
)
def test_a_wrong_camera_info_is_named_and_does_no_harm(sample_logs, tmp_path, tmp_path_factory, edit, named):
    log = edited(sample_logs / "paper_robot.mcap", tmp_path_factory.mktemp("logs") / "log.mcap", edit)
    result = run("calibrate", log, "--output", "out", "-v", cwd=tmp_path)
    assert result.code in (0, 6), result.err
    out = " ".join(result.out.split())
    assert named in out
    assert out.count("Robot description: Board: size of the squares") <= 1
    found = parameters_from_yaml((tmp_path / "out/params.yaml").read_text(encoding="utf-8"))
    true = truth_of(sample_logs / "paper_robot.truth.yaml")
    error = Parameters(found.T_parent_child, found.wheels).minus(true)
    std = np.sqrt(np.diag(found.knowledge.covariance))
    assert np.max(np.abs(error) / std) < 4
