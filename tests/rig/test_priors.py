import math
import re

import pytest
import yaml

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.constants import KINDS, OF_RECORDINGS, table
from mobilecal_cli.model.rig import HeadChain, JointLink
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.draft import draft_rig
from mobilecal_cli.rig.resolve import survey_rig
from mobilecal_cli.rig.settings import prior_sigmas
from mobilecal_cli.simulate.robot import ROBOTS
from tests.rig.test_resolve import AT_BASE, config, description, resolve_rig

CAMERAS = ROBOTS["paper"].rig_cameras
CHAIN = HeadChain(
    "base",
    "head",
    (JointLink("lift", [0, 0, 1], "prismatic"), JointLink("neck", [0, 0, 1]), JointLink("nod", [0, 1, 0])),
    pan="neck",
    tilt="nod",
)
ROWS = {row.name: row for row in table(CAMERAS, CHAIN)}


def sigmas(**entries):
    return prior_sigmas(entries, CAMERAS, CHAIN)


def test_units_are_those_of_the_kinds():
    assert sigmas() == {}
    found = sigmas(focal_length=0.5, joint_zero=2, board_bend=3, clock=10, distortion=0.2)
    assert found["focal_left"] == found["focal_right"] == pytest.approx(0.005)
    assert found["pan_zero"] == pytest.approx(math.radians(2))
    assert found["lift_zero"] == pytest.approx(0.1 * math.radians(2))  # a prismatic joint: 0.1 m for 1 rad
    assert found["board_bend_x"] == pytest.approx(0.003)
    assert found["time_wheels"] == pytest.approx(0.01)
    assert found["distortion_right_tangential_y"] == pytest.approx(0.002)
    assert "baseline_scale" not in found


def test_the_defaults_as_entries_are_the_defaults():
    found = sigmas(**{kind.name: kind.sigma * kind.shown for kind in KINDS})
    of_kinds = {kind.name: kind.sigma for kind in KINDS if kind.name in OF_RECORDINGS}
    assert found == pytest.approx(of_kinds | {name: row.sigma for name, row in ROWS.items()}, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("focal_lenght", "did you mean focal_length?"),
        ("pan_zeros", "did you mean pan_zero?"),
        ("!", "kinds: "),
    ],
)
def test_unknown_names(name, hint):
    with pytest.raises(ConfigError, match=re.escape(f"priors.{name}: ")) as caught:
        prior_sigmas({name: 1.0}, CAMERAS, CHAIN)
    assert hint in caught.value.hint


def test_a_rig_has_them_and_an_inspection_names_unknown_ones():
    rig = resolve_rig(config(priors={"pan_zero": "free"}), description())[0]
    assert rig.prior_sigmas == {"pan_zero": math.inf}
    wrong = config(priors={"neck_zero": 1})
    assert [(part, error.message) for part, error in survey_rig(wrong, description(urdf=AT_BASE)).lacks] == [
        ("priors", "priors.neck_zero: this robot has no such constant")
    ]
    with pytest.raises(ConfigError):
        resolve_rig(wrong, description())


def test_the_draft_lists_every_kind_with_its_default():
    text = draft_rig(survey_rig(RigConfig(), description()), "log.mcap").text
    section = text[text.index("# priors:") :]
    active = "\n".join(line.removeprefix("# ") for line in section.splitlines())
    priors = RigConfig.model_validate(yaml.safe_load(active)).priors
    assert priors == pytest.approx({kind.name: kind.sigma * kind.shown for kind in KINDS}, rel=1e-3)
