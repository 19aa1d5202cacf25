"""Discovery of cameras, joints, wheels and head chain by message type and name, where not configured."""

from mobilecal_cli.discovery.draft import draft_rig
from mobilecal_cli.discovery.priors import prior_sigmas, shown_priors
from mobilecal_cli.discovery.settle import Settled, lacking, settle_rig

__all__ = ["Settled", "draft_rig", "lacking", "prior_sigmas", "settle_rig", "shown_priors"]
