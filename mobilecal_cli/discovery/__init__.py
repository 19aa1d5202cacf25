"""What the robot is, found by message type and name where the configuration does not say."""

from mobilecal_cli.discovery.draft import draft_rig
from mobilecal_cli.discovery.settle import Settled, lacking, settle_rig

__all__ = ["Settled", "draft_rig", "lacking", "settle_rig"]
