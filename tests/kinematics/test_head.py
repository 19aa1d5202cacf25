import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.kinematics import head_jacobian, head_pose
from mobilecal_cli.kinematics.urdf import chain_links, parse_urdf, vehicle_frame
from mobilecal_cli.model.rig import FixedLink, HeadChain, JointLink

PAN_TILT = HeadChain(
    "base_link",
    "head_link",
    (
        FixedLink(se3.transform(np.eye(3), np.array([0.1, 0.0, 0.9]))),
        JointLink("pan", np.array([0.0, 0.0, 1.0])),
        FixedLink(se3.transform(np.eye(3), np.array([0.2, 0.0, 0.0]))),
        JointLink("tilt", np.array([0.0, 1.0, 0.0])),
    ),
)


def test_pan_tilt_and_lift_by_hand():
    T = head_pose(PAN_TILT, np.array([np.pi / 2, 0.0]))
    assert T[:3, 3] == pytest.approx([0.1, 0.2, 0.9])
    assert T[:3, 0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)  # the head looks to the left
    T = head_pose(PAN_TILT, np.array([0.0, np.pi / 2]))
    assert T[:3, 0] == pytest.approx([0.0, 0.0, -1.0], abs=1e-15)
    lift = JointLink("lift", np.array([0, 0, 1.0]), "prismatic", multiplier=2.0, offset=0.1)
    chain = HeadChain("b", "h", (lift,))
    assert head_pose(chain, np.array([[0.3]]))[0, :3, 3] == pytest.approx([0, 0, 0.7])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_jacobian_against_differences(seed):
    random = np.random.default_rng(seed)
    links = []
    for i in range(4):
        links.append(FixedLink(se3.exp(random.normal(size=6))))
        axis, kind = random.normal(size=3), "prismatic" if i == 2 else "revolute"
        name = f"j{i % 3}"  # one joint read twice, as a mimic is
        links.append(JointLink(name, axis / np.linalg.norm(axis), kind, random.normal(), random.normal()))
    chain = HeadChain("b", "h", tuple(links))
    q = random.normal(size=(2, 3))
    J = head_jacobian(chain, q)
    for k in range(3):
        h = 1e-6 * np.eye(3)[k]
        difference = se3.log(se3.inverse(head_pose(chain, q - h)) @ head_pose(chain, q + h)) / 2e-6
        assert J[..., k] == pytest.approx(difference, abs=1e-7)


URDF = """<?xml version="1.0"?>
<robot name="r">
  <link name="base_link"/><link name="head"/>
  <link name="wheel_l"><collision><geometry><cylinder radius="0.19" length="0.07"/></geometry></collision>
    <collision><geometry><cylinder radius="0.21" length="0.05"/></geometry></collision></link>
  <joint name="wl" type="continuous"><parent link="base_link"/><child link="wheel_l"/>
    <origin xyz="-0.1 0.3 0"/><axis xyz="0 1 0"/></joint>
  <joint name="wr" type="continuous"><parent link="base_link"/><child link="wheel_r"/>
    <origin xyz="-0.1 -0.2 0"/><axis xyz="0 1 0"/></joint>
  <joint name="neck" type="fixed"><parent link="base_link"/><child link="neck"/><origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="pan" type="revolute"><parent link="neck"/><child link="head"/><axis xyz="0 0 2"/></joint>
  <transmission name="t"><joint name="pan"/></transmission>
</robot>"""


def test_urdf_chain_and_what_it_lacks():
    urdf = parse_urdf(URDF)
    chain = HeadChain("base_link", "head", chain_links(urdf, "base_link", "head"), "pan")
    assert chain.joints == ("pan",)
    T = head_pose(chain, np.array([0.0]))
    assert T[:3, 3] == pytest.approx([0, 0, 1])
    assert T[:3, 0] == pytest.approx([0, 1, 0], abs=1e-12)
    assert urdf.root == "base_link"
    assert urdf.cylinder_radius_m == {"wheel_l": 0.21}  # the tire, not the hub
    slashed = parse_urdf(URDF.replace('link="', 'link="/').replace('<link name="', '<link name="/'))
    assert (slashed.links, slashed.cylinder_radius_m) == (urdf.links, urdf.cylinder_radius_m)
    with pytest.raises(ConfigError) as caught:
        parse_urdf(URDF).path("base_link", "camera")
    assert "'camera'" in caught.value.message
    assert "wheel_l" in caught.value.hint


def test_vehicle_frame_is_midway_between_the_wheels():
    urdf = parse_urdf(URDF)
    T_base_v = vehicle_frame(
        *(urdf.pose("base_link", link)[:3, 3] for link in ("wheel_l", "wheel_r")), np.array([0.0, 0, 1])
    )
    assert T_base_v[:3, 3] == pytest.approx([-0.1, 0.05, 0])
    assert T_base_v[:3, :3] == pytest.approx(np.eye(3))
    links = (FixedLink(se3.inverse(T_base_v)), *chain_links(urdf, "base_link", "head"))
    chain = HeadChain("base_link", "head", links, "pan")
    assert head_pose(chain, np.array([0.0]))[:3, 3] == pytest.approx([0.1, -0.05, 1])


JOINT = '<robot><joint name="a" type="{}"><parent link="p"/><child link="c"/>{}</joint></robot>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("not xml", "not valid XML"),
        ("<model/>", "not <robot>"),
        ('<!DOCTYPE r [<!ENTITY x "y">]><robot name="r"/>', "not valid XML"),
        (
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="a"/></robot>',
            "xacro file",
        ),
        ('<robot name="r"><joint name="a" type="fixed"/></robot>', "no <parent"),
        (JOINT.format("fixed", '<origin xyz="1 2"/>'), "3 finite number"),
        (JOINT.format("revolute", '<axis xyz="0 0 0"/>'), "zero length"),
    ],
)
def test_bad_urdf(text, words):
    with pytest.raises(ConfigError, match=words):
        parse_urdf(text)


STRETCH = "urdf/stretch/stretch_urdf/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf"


@pytest.mark.parametrize(
    ("path", "base", "head", "joints"),
    [
        (STRETCH, "base_link", "link_head_tilt", ("joint_head_pan", "joint_head_tilt")),
        ("urdf/hsr/robots/hsrb4s.urdf", "base_link", "head_tilt_link", None),
    ],
)
def test_real_urdfs_give_their_heads(shared_data, path, base, head, joints):
    urdf = parse_urdf((shared_data / path).read_text())
    chain = HeadChain(base, head, chain_links(urdf, base, head))
    if path == STRETCH:
        assert chain.joints == joints
        wheels = ("joint_left_wheel", "joint_right_wheel")
        left, right = (urdf.pose("base_link", urdf.joints[name].child)[:3, 3] for name in wheels)
        assert np.linalg.norm(left - right) == pytest.approx(0.3407, abs=1e-4)  # as published
    assert any("pan" in name for name in chain.joints)
    assert np.isfinite(head_pose(chain, np.zeros(len(chain.joints)))).all()
